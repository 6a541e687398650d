"""The headless simulator against bridges: our own, and one of the kind that people have."""
import json
import socket
import subprocess
import tempfile
import time

from bridge import ENVIRONMENT, HERE, Bridge, Failed, equal, lapwing, python, within

SECONDS, HZ = 20, 15


def simulate_serve(_):
    """Our own bridge, with ground truth, without it, in another culture, and with a human at the wheel."""
    with Bridge() as bridge:
        address = f"127.0.0.1:{bridge.port}"
        run = ["simulate", "--json", "--max-time", SECONDS, "--connect", address]
        told = lapwing(*run, "--culture", "de-DE")
        again = lapwing(*run)
        lapwing(*run, "--stock")
        human = lapwing(*run, "--human-from", 5, "--human-for", 4)
    for key in ("distance_m", "mean_cte_m"):
        equal(f"{key} of the same drive in German and in English", told[key], again[key])
    drives = [(s["dialect"], s["telemetries"], s["human_messages"], s["bad_frames"]) for s in bridge.summaries]
    equal("drives (dialect, telemetries, human messages, bad frames)", drives, [
        ("self-oracle", SECONDS * HZ, 0, 0), ("self-oracle", SECONDS * HZ, 0, 0),
        ("term1", SECONDS * HZ, 0, 0), ("self-oracle", (SECONDS - 4) * HZ, 4 * HZ, 0)])
    equal("takeovers and the human's seconds", (human["takeovers"], round(human["human_s"], 1)), (1, 4.0))
    return f"{told['distance_m']:.1f} m alike in de-DE and en-US, stock and human spans whole"


def simulate_drive_py(_):
    """python-socketio 4 on eventlet, the bridge that most people run."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    # A file, since nobody reads while it runs.
    log = tempfile.TemporaryFile("w+")
    bridge = subprocess.Popen([python("drive-py"), HERE / "drive_py.py", str(port)], env=ENVIRONMENT,
                              stdout=log, stderr=subprocess.PIPE, text=True)
    try:
        end = time.monotonic() + 15
        while True:
            try:
                socket.create_connection(("127.0.0.1", port), 1).close()
                break
            except OSError:
                if bridge.poll() is not None or time.monotonic() > end:
                    raise Failed(f"drive_py.py: expected it to listen, got {bridge.stderr.read()[-300:]}") from None
                time.sleep(0.1)
        began = time.monotonic()
        card = lapwing("simulate", "--json", "--max-time", SECONDS, "--connect", f"127.0.0.1:{port}")
        took = time.monotonic() - began
    finally:
        bridge.terminate()
        bridge.communicate()
    log.seek(0)
    lines = [json.loads(line) for line in log]
    within("telemetries", len(lines), SECONDS * HZ, SECONDS * HZ + 2)
    keys = ["steering_angle", "throttle", "speed", "lapNumber", "currentWayPoint", "crash", "tot_obes", "tot_crashes"]
    equal("first keys", list(lines[0])[:len(keys)], keys)
    equal("times off the road, steered by cte and ang_diff over the wire", card["off_roads"], 0)
    within("metres driven", card["distance_m"], 60)
    return f"{card['distance_m']:.1f} m on the road, mean |cte| {card['mean_cte_m']:.2f} m; {len(lines) / took:.0f} frames/s"
