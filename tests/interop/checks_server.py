"""What the bridge bears: malformed messages, strangers, a taken port, a redial storm."""
import base64
import concurrent.futures
import glob
import os
import re
import subprocess
import time

from bridge import ENVIRONMENT, LAPWING, Bridge, Failed, equal, jpeg, telemetry, wait_for, within
from wire import BINARY, TEXT, Wire


def oversized(image):
    """The same JPEG, whose start of frame claims 30000 x 30000 pixels."""
    at = re.search(rb"\xff[\xc0-\xc2]\x00\x11\x08", image).end()
    return image[:at] + (30000).to_bytes(2, "big") * 2 + image[at + 4:]


def bad_messages():
    """Name, message, opcode. The car does 20 mph where a message can say so: only above 5 mph a brake is a brake."""
    def image(data):
        return telemetry(base64.b64encode(data).decode(), speed="20.0000")

    frame = jpeg()
    deep = "[" * 200_000 + "]" * 200_000
    return [
        ("broken base64", telemetry("*** no base64 ***", speed="20.0000"), TEXT),
        ("base64 of no JPEG", image(b"no picture " * 500), TEXT),
        ("a JPEG cut in half", image(frame[:len(frame) // 2]), TEXT),
        ("a JPEG of 30000 x 30000", image(oversized(frame)), TEXT),
        ("no speed, no throttle", telemetry(speed=None, throttle=None), TEXT),
        ("no image", telemetry(speed="20.0000").replace('"image"', '"other"'), TEXT),
        ("a speed of NaN", telemetry(speed="NaN"), TEXT),
        ("absurd numbers", telemetry(speed="999,999,999,999,999,999.0000", steering_angle="-1" + "0" * 400), TEXT),
        ("4 MB of text as image", telemetry("A" * 4_000_000, speed="20.0000"), TEXT),
        ("a binary message", b"\x04" + frame, BINARY),
        ("JSON 200,000 deep", '42["telemetry",{"speed":"20.0000","image":%s}]' % deep, TEXT),
        ("an event cut off", telemetry()[:200], TEXT),
        ("no packet at all", "hello", TEXT),
    ]


def abuse(_):
    bad, slowest = bad_messages(), (0, "")
    good = telemetry()
    with Bridge() as bridge:
        wire = Wire(bridge.port)
        wire.send(good)
        within("throttle of a good frame at 0 mph", wire.answer()[2], 0.01, 1)
        for i, (name, message, opcode) in enumerate(bad, 1):
            wire.send(message, opcode)
            began = time.monotonic()
            try:
                answer = wire.answer(2.0)
            except Failed as failure:
                raise Failed(f"{name}: {failure}")
            slowest = max(slowest, (time.monotonic() - began, name))
            equal(f"{name} ({i} bad in a row): answer and throttle", (answer[0], answer[2]), ("steer", -1.0 if i >= 5 else 0.0))
            equal(f"{name}: a second answer", wire.receive(0.1), None)
        wire.send(good)
        within("throttle of a good frame after bad ones", wire.answer()[2], 0.01, 1)
        # A first message without an image is of no simulator known: the wheel is left to the player.
        stranger = Wire(bridge.port)
        stranger.send(good.replace('"image"', '"other"'))
        equal("answer to a first telemetry without image", stranger.answer()[0], "manual")
        wire.close()
        stranger.close()
    summary = bridge.summary()
    equal("bad frames, telemetries", (summary["bad_frames"], summary["telemetries"]), (len(bad), len(bad) + 2))
    return f"{len(bad)} bad messages, each one answer; slowest {slowest[0] * 1e3:.0f} ms ({slowest[1]})"


def unknown_agent(_):
    with Bridge() as bridge:
        wire, times = Wire(bridge.port, agent="Unity/2020"), []
        for _ in range(20):
            began = time.monotonic()
            wire.send(telemetry())
            equal("answer", wire.answer()[0], "steer")  # an OPEN packet would fail here
            times.append(time.monotonic() - began)
        wire.send("2")
        equal("answer to a ping", wire.receive(1), "3")
        wire.close()
    equal("telemetries", bridge.summary()["telemetries"], 20)
    return f"20 steers, the first after {times[0] * 1e3:.0f} ms, then {sorted(times)[10] * 1e3:.1f} ms"


def busy_port(_):
    with Bridge() as bridge:
        second = subprocess.run([LAPWING, "serve", "--port", str(bridge.port), "--no-recording"], cwd=bridge.dir,
                                env=ENVIRONMENT, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=30)
        equal("exit status of a second serve", second.returncode, 1)
        if str(bridge.process.pid) not in re.findall(r"\d+", second.stderr):
            raise Failed(f"stderr of a second serve: expected process {bridge.process.pid}, got {second.stderr!r}")
        Wire(bridge.port).close()  # and the first still serves
    return f"exit 1, process {bridge.process.pid} is named"


def redial_storm(_):
    dials = 2000
    with Bridge() as bridge, concurrent.futures.ThreadPoolExecutor() as pool:
        held, wire, good = sockets(bridge.process.pid), Wire(bridge.port), telemetry()
        wire.send(good)
        wire.answer()
        before, began, slowest, answered = len(bridge.log.splitlines()), time.monotonic(), 0, 0
        storm = pool.submit(lambda: [Wire(bridge.port).close() for _ in range(dials)])
        while not storm.done():
            asked = time.monotonic()
            wire.send(good)
            wire.answer()
            slowest, answered = max(slowest, time.monotonic() - asked), answered + 1
        storm.result()  # fails where a dial failed
        rate = dials / (time.monotonic() - began)
        within("slowest answer to a simulator that plays meanwhile, s", slowest, 0, 0.25)
        wire.close()
        wait_for("all connections closed again", 5, lambda: sockets(bridge.process.pid) <= held)
        lines = bridge.log.splitlines()[before:]
        if len(lines) > 8:
            raise Failed(f"log lines for {dials} dials: expected 8 at most, got {len(lines)}, such as {lines[-1]!r}")
    return f"{dials} dials at {rate:.0f}/s, {len(lines)} log lines, {answered} answers meanwhile, slowest {slowest * 1e3:.0f} ms"


def sockets(pid):
    """How many sockets a process holds, by Linux's /proc; elsewhere 0."""
    def kind(handle):
        try:
            return os.readlink(handle)
        except OSError:  # closed meanwhile
            return ""
    return sum(kind(handle).startswith("socket:") for handle in glob.glob(f"/proc/{pid}/fd/*"))
