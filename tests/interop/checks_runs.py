"""Run files, as the stock Python packages read them: whole, cut off by kill -9, and ended by signals."""
import hashlib
import signal
import time

from bridge import HERE, RUNS, Bridge, Failed, Unity, equal, lapwing, python, read_run, run_json, sent_frames, telemetry, wait_for, within
from checks_drives import fast_drive
from wire import Wire


def run_file(_):
    result, summary, files = fast_drive()
    equal("files", [str(f) for f in files], [summary["run"]["path"]])
    run, count = read_run(files[0]), result["telemetries"]
    counts = {topic: run["counts"].get(topic, 0) for topic in ("/camera/center", "/telemetry", "/command")}
    equal("messages by topic", counts, dict.fromkeys(counts, count))
    equal("frames in the summary", (summary["run"]["frames"], summary["run"]["not_recorded"]), (count, 0))
    equal("messages by the footer's statistics", run["in_footer"], sum(run["counts"].values()))
    equal("metadata lapwing.run", "lapwing.run" in run["metadata"], True)
    for topic, needed in (("/telemetry", {"steering_deg", "throttle", "speed_mph"}),
                          ("/command", {"by", "steering", "throttle", "latency_ns"})):
        equal(f"fields of {topic} that are missing", needed - set(run["keys"][topic]), set())
    sent = [hashlib.sha256(file.read_bytes()).hexdigest() for file in sent_frames(count)]
    wrong = [i for i, (a, b) in enumerate(zip(sent, run["frames"])) if a != b]
    equal("first frames that are not the ones sent", wrong[:5], [])
    return f"{count} frames are the bytes sent, in order; {run['counts']}"


def crash(_):
    with Bridge() as bridge:
        client = Unity(bridge, "--fps", 30, "--count", 1000, "--stall", 1)
        file = wait_for("a file of the run", 10, lambda: bridge.recordings)[0]
        time.sleep(4)
        bridge.kill()
        sent = client.result()["telemetries"]
    least = int((4 - 1.2) * 30)
    stock, report = read_run(file, "--cut-off"), lapwing("replay", file, "--json")
    equal("the stock reader comes to the file's end", stock["ended"] == "whole", False)
    within("frames by the stock reader", stock["counts"].get("/camera/center", 0), least, sent)
    within("moments by lapwing replay", report["moments"], least, sent)
    if not report.get("cut_off"):
        raise Failed(f"replay of a cut-off run: expected the field cut_off, got {sorted(report)}")
    return f"{report['moments']} of {sent} moments, stock reader {stock['counts']['/camera/center']}, at least {least} wanted"


def signals(_):
    figures = []
    for by in (signal.SIGTERM, signal.SIGINT):
        with Bridge() as bridge:
            client = Unity(bridge, "--fps", 30, "--count", 1000)
            wait_for("a file of the run", 10, lambda: bridge.recordings)
            time.sleep(1.5)
            began = time.monotonic()
            bridge.stop(by)
            took = time.monotonic() - began
            client.result()
        summary, file = bridge.summary(), bridge.recordings[-1]
        run = read_run(file)
        within(f"{by.name}: telemetries", summary["telemetries"], 15)
        equal(f"{by.name}: messages by the footer's statistics", run["in_footer"], sum(run["counts"].values()))
        equal(f"{by.name}: frames", run["counts"]["/camera/center"], summary["telemetries"])
        figures.append(f"{by.name}: {summary['telemetries']} frames, ended in {took:.2f} s")
    return "; ".join(figures)


def schemas(_):
    """Drives that are finished, crashed, put back and taken over, driven here and over the bridge."""
    folder = RUNS / "schemas"
    drive = ["drive", "--json", "--hz", 5, "--recordings", folder]
    lapwing(*drive, "--track", "lake", "--pilot", "expert", "--speed", 30)
    lapwing(*drive, "--scenario", "ccrs")  # into a car that stands
    for on_crash in ("stop", "reset"):  # whose commands take effect two seconds late leaves the road on any processor
        late = ["--pilot", "expert", "--track", "jungle", "--speed", 30, "--conditions", "night=1,haze=1,latency_ms=2000"]
        lapwing(*drive, *late, "--on-crash", on_crash, "--max-time", 30)
    with Bridge() as bridge:
        simulate = ["simulate", "--json", "--connect", f"127.0.0.1:{bridge.port}"]
        lapwing(*simulate, "--scenario", "ccrs")
        lapwing(*simulate, "--max-time", 8, "--human-from", 3, "--human-for", 2)
        wire = Wire(bridge.port)
        for message in (telemetry(), '42["episode_event",{"name":"lap"}]', "garbage", telemetry()):
            wire.send(message)
            wire.receive(0.3)
        time.sleep(1.5)  # until it is kicked
        wire.close()
    runs = [*sorted(folder.glob("*.mcap")), *bridge.recordings]
    equal("runs", len(runs), 7)
    found = run_json([python("mcap"), HERE / "check_schemas.py", *runs])
    needed = {"bad-frame", "collision", "course", "kick", "lap", "off-road", "reset", "run-ended", "simulator", "takeover-began", "takeover-ended"}
    equal("kinds of events that are missing", needed - set(found["kinds"]), set())
    return f"{sum(found['counts'].values())} messages, {len(found['kinds'])} kinds of events"
