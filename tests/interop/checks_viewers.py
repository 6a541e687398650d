"""Foxglove, Lichtblick and Rerun: what they read of a drive, as it happens and afterwards."""
import json
import re
import subprocess
from collections import Counter

from bridge import ENVIRONMENT, HERE, RUNS, Bridge, equal, lapwing, node, python, read_run, run_json, wait_for, within
from checks_live import Program

TOPICS = ["/camera/center", "/command", "/event", "/log", "/scene", "/telemetry", "/tf"]
ADDRESS = r"Foxglove, Lichtblick: (ws://127\.0\.0\.1:\d+/)"


def address(program):
    return wait_for("the address for viewers", 60, lambda: re.search(ADDRESS, program.log))[1]


def seen(found, telemetries):
    """What holds of a drive by the expert on the lake, however it was read."""
    equal("topics", sorted(found["counts"]), TOPICS)
    equal("telemetries", found["counts"]["/telemetry"], telemetries)
    equal("entities", found["entities"], [["car", "car"], ["road", "world"]])
    equal("messages out of order", found["late"], 0)
    within("points of the road", found["road_points"][0], 400)
    within("telemetries in which the car goes ahead", found["directions"].get("ahead"), telemetries // 2)
    within("of those in which it goes astern", found["directions"].get("astern", 0), 0, 0)
    within("metres from the road's edge", found["off_m"], 0, 8)
    equal("the log's last line", found["lines"][-1], [2, "the run ended: time limit reached"])


def foxglove(_):
    """A drive in this program and one that connects, each seen by both names of the protocol and read again from its run."""
    folder, reader = RUNS / "viewers", [python("foxglove"), HERE / "foxglove_reader.py"]
    drive = ("drive", "--foxglove", 0, "--pilot", "expert", "--track", "lake", "--max-time", 8, "--hz", 10, "--recordings", folder, "--json")
    with Program("viewed-drive", *drive) as program:
        live = run_json([*reader, address(program), "foxglove.sdk.v1"])
        equal("exit status of the drive", program.process.wait(20), 0)
    (run,) = folder.glob("*.mcap")
    recorded = run_json([*reader, run])
    telemetries = recorded["counts"]["/telemetry"]
    seen(recorded, telemetries)
    # The first ones may have been before anybody looked.
    missed = telemetries - live["counts"]["/telemetry"]
    within("telemetries before the viewer came", missed, 0, 20)
    seen(live, telemetries - missed)
    equal("transforms", live["counts"]["/tf"], min(recorded["counts"]["/tf"], telemetries - missed))
    equal("scenes in the run", recorded["counts"]["/scene"], 1)

    with Bridge("--foxglove", "0") as bridge:
        view = subprocess.Popen([str(c) for c in [*reader, address(bridge), "foxglove.websocket.v1"]], stdout=subprocess.PIPE, text=True)
        try:
            lapwing("simulate", "--connect", f"127.0.0.1:{bridge.port}", "--track", "lake", "--max-time", 5, "--realtime", "--json")
            bridge.stop()
            served = json.loads(view.communicate(timeout=20)[0])
        finally:
            view.kill()
    count = bridge.summary()["telemetries"]
    within("telemetries of the bridge's drive", served["counts"].get("/telemetry"), count - 20, count)
    equal("scenes without a position", served["counts"].get("/scene"), None)
    return (f"{live['counts']['/telemetry']} of {telemetries} telemetries and {live['counts']['/camera/center']} pictures live, "
            f"{served['counts']['/telemetry']} of {count} over the bridge; schemas are Foxglove's own")


def lichtblick(_):
    """The client that Lichtblick is built on."""
    program, folder = node()
    drive = ("drive", "--foxglove", 0, "--pilot", "expert", "--max-time", 6, "--no-recording", "--json")
    with Program("viewed-by-client", *drive) as drives:
        found = run_json([program, HERE / "viewer.js", address(drives)], folder)
    equal("topics", sorted(found["counts"]), TOPICS)
    return f"{found['counts']['/telemetry']} telemetries by @foxglove/ws-protocol"


# What Rerun makes of a channel, by the name that it prints.
BY_RERUN = {"/camera/center": "EncodedImage:blob", "/log": "TextLog:text", "/tf": "Transform3D:translation"}


def rerun(_):
    folder = RUNS / "rerun"
    lapwing("drive", "--pilot", "expert", "--max-time", 6, "--hz", 10, "--json", "--recordings", folder)
    (run,) = folder.glob("*.mcap")
    program = python("rerun").with_name("rerun")
    environment = {**ENVIRONMENT, "HOME": str(folder)}

    def said(*arguments):
        done = subprocess.run([str(a) for a in (program, *arguments)], env=environment, capture_output=True, text=True, timeout=120)
        equal(f"exit of rerun {arguments[0]} ({done.stderr[-300:].strip()})", done.returncode, 0)
        return done.stdout

    said("analytics", "disable")  # else it tells its makers that it is used
    said("mcap", "convert", run, "-o", folder / "run.rrd")
    rows = Counter()
    for line in said("rrd", "print", folder / "run.rrd").splitlines():
        chunk = re.match(r"Chunk\(\w+\) with (\d+) rows .* - (\S+) - data columns: \[(.*)\]", line)
        if chunk and BY_RERUN.get(chunk[2]) in chunk[3].split():
            rows[chunk[2]] += int(chunk[1])
    counts = read_run(run)["counts"]
    equal("rows", dict(rows), {topic: counts[topic] for topic in BY_RERUN})
    return f"{rows['/camera/center']} pictures, {rows['/log']} lines of the log, {rows['/tf']} transforms"
