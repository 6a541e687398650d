"""Drives by the stand-in simulator: speed, lock-step, cultures, a late start, a human, eight at once, replays."""
import csv
import functools
import itertools
import json

from bridge import FRAMES, ROOT, RUNS, SHARED, Bridge, Failed, Unity, equal, lapwing, read_run, unharmed, within


@functools.lru_cache(maxsize=None)
def fast_drive():
    """2000 real frames as fast as the bridge answers: the client's account, the summary, the run's file."""
    with Bridge() as bridge:
        result = Unity(bridge, "--count", 2000).result()
    return result, bridge.summary(), bridge.recordings


def fast(_):
    result, summary, _ = fast_drive()
    figures = unharmed(result, 2000)
    equal("telemetries in the summary", summary["telemetries"], 2000)
    equal("dialect", summary["dialect"], "term1")
    equal("bad frames", summary["bad_frames"], 0)
    equal("kicks", summary["kicks"], 0)
    # No figure, a trap: without TCP_QUICKACK after every read each answer waits 40 ms.
    within("median round trip, ms", result["rtt_p50_ms"], 0, 20)
    return f"2000 telemetries, {summary['frames_per_s']:.0f}/s, {figures}; bridge's own p99 {summary['latency_ms']['answer']['p99']} ms"


def guarded(_):
    # As fast as the simulator sends: of faster frames, the network looks at every so many.
    with Bridge("--brake-model", ROOT / "models/brake.safetensors") as bridge:
        result = Unity(bridge, "--fps", 15, "--count", 150).result()
    figures, summary = unharmed(result, 150), bridge.summary()
    equal("telemetries in the summary", summary["telemetries"], 150)
    said = set(read_run(bridge.recordings[0])["keys"]["/command"])
    equal("what the guard said beside each command", said & {"brake_due", "guard_ns"}, {"brake_due", "guard_ns"})
    return f"150 telemetries, {figures}; the guard's own p50 {summary['latency_ms']['guard']['p50']} ms"


def steady(quick):
    seconds, fps = (10, 60) if quick else (60, 60)
    with Bridge() as bridge:
        result = Unity(bridge, "--fps", fps, "--seconds", seconds, "--count", 4000).result()
    figures = unharmed(result)
    within("telemetries", result["telemetries"], 0.95 * seconds * fps)
    within("steers", result["steers"], result["telemetries"] - 1, result["telemetries"])  # the end may cut one off
    run = bridge.summary()["run"]
    equal("items not recorded", run["not_recorded"], 0)
    return f"{result['telemetries']} telemetries in {seconds} s, {figures}"


CULTURES = ("en-US", "fr-FR", "de-CH", "de-DE")


def cultures(_):
    figures = []
    with Bridge() as bridge:
        for culture in CULTURES:
            commands = bridge.dir / f"{culture}.csv"
            unharmed(Unity(bridge, "--culture", culture, "--count", 200, "--commands", commands).result(), 200)
            rows = list(csv.DictReader(commands.open()))
            equal(f"{culture}: commands", len(rows), 200)
            for field in ("steering", "throttle"):
                values = [float(row[field]) for row in rows]
                within(f"{culture}: lowest {field}", min(values), -1, 1)
                within(f"{culture}: highest {field}", max(values), -1, 1)
                within(f"{culture}: different values of {field}", len(set(values)), 20)
            figures.append([row["steering"] for row in rows])
    for culture, steering in zip(CULTURES[1:], figures[1:]):
        equal(f"{culture}: steering as in en-US", steering, figures[0])
    speeds = [summary["max_mph"] for summary in bridge.summaries]
    equal("highest speed read, by culture", speeds, [30.19] * 4)
    settings = bridge.dir / "doctor.toml"
    settings.write_text(f"[bridge]\nport = 0\n[recording]\ndir = {json.dumps(str(bridge.dir / 'mcap'))}\n")
    last = lapwing("doctor", "--json", "--config", settings)["last_simulator"]
    equal("decimals of the last simulator, as the doctor says", last["decimal_separator"], ",")
    return f"4 x 200 commands agree, {len(set(figures[0]))} different steering values"


def late_start(_):
    with Bridge() as bridge:
        result = Unity(bridge, "--late-start", "--count", 200).result()
    figures = unharmed(dict(result, steers=result["steers"] - 1), 200)  # one more than asked for: the kick
    equal("kicks in the summary", bridge.summary()["kicks"], 1)
    return f"200 telemetries after one kick, {figures}"


def human(_):
    with Bridge() as bridge:
        result = Unity(bridge, "--manual-from", 50, "--manual-for", 40, "--count", 200).result()
    unharmed(result)
    equal("telemetries", result["telemetries"], 200)
    equal("steers", result["steers"], 160)
    equal("manual replies", result["manual_replies"], 40)
    summary = bridge.summary()
    equal("takeovers and human messages", (summary["takeovers"], summary["human_messages"]), (1, 40))
    return "160 steers, 40 manual replies, 1 takeover"


def many(quick):
    seconds, fps, simulators = (8 if quick else 20), 15, 8
    count = seconds * fps
    with Bridge() as bridge:
        # Five per cent more time than the frames need: who answers later than that fails.
        clients = [Unity(bridge, "--fps", fps, "--count", count, "--seconds", seconds * 1.05) for _ in range(simulators)]
        results = [client.result() for client in clients]
    for result in results:
        unharmed(result)
        equal("telemetries", result["telemetries"], count)
        equal("steers", result["steers"], count)
    equal("summaries", len(bridge.summaries), simulators)
    equal("items not recorded", sum(s["run"]["not_recorded"] for s in bridge.summaries), 0)
    least, worst = min(r["telemetries"] for r in results), max(r["rtt_p99_ms"] for r in results)
    return f"{simulators} x {least} of {count} telemetries at least, worst rtt p99 {worst} ms"


def replay(_):
    folder = RUNS / "lake-head"
    folder.mkdir()
    (folder / "IMG").symlink_to(FRAMES)
    with open(SHARED / "recordings" / "lake" / "driving_log.csv") as log:
        (folder / "driving_log.csv").write_text("".join(itertools.islice(log, 300)))
    here = lapwing("replay", folder, "--json")
    with Bridge() as bridge:
        there = lapwing("replay", folder, "--json", "--connect", f"127.0.0.1:{bridge.port}")
    for report in (here, there):
        equal("moments", report["moments"], 300)
        within("frames compared", report["steering"]["frames"], 300, 300)
    mae, mae_there = here["steering"]["mae"], there["steering"]["mae"]
    if not abs(mae - mae_there) <= 1e-3:
        raise Failed(f"steering MAE over the bridge: expected {mae} within 0.001, got {mae_there}")
    return (f"MAE {mae:.4f} and {mae_there:.4f}; in process {here['frames_per_s']:.0f}/s, p99 {here['latency']['p99_ms']:.2f} ms; "
            f"bridge {there['frames_per_s']:.0f}/s, p99 {there['latency']['p99_ms']:.2f} ms")
