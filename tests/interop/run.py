#!/usr/bin/env python3
"""Real clients against the real bridge: `target/release/lapwing`, built before.

    tests/interop/run.py [--quick] [--only NAME …] [--jobs N] [--browser NAME] [--list]

Each check prints one line with what it measured. The last line is
`N passed, N failed[, N skipped]`; the exit status is 1 if a check failed.
Checks that measure no time run first, two at a time or as many as `--jobs`
says; each of the others has the machine to itself.

Python 3.9 or newer, its standard library, and pip 22.3 or newer. Stock packages go into virtual
environments and a node_modules under `target/interop/`, made once. Checks by
the stand-in simulator need the shared folder (LAPWING_SHARED, by default
`shared` beside the checkout) and are skipped without it, those of the
JavaScript clients and of the pages without Node.js, those of the pages
without the browser; with LAPWING_REQUIRE_SHARED=1 they fail instead.
"""
import argparse
import concurrent.futures
import shutil
import sys
import time

import checks_clients
import checks_drives
import checks_live
import checks_models
import checks_page
import checks_runs
import checks_server
import checks_simulate
import checks_viewers
import rough
from bridge import ENVIRONMENT, FRAMES, LAPWING, REQUIRE_SHARED, RUNS, SHARED, Failed, Skipped

# Name, check, whether it needs the shared folder, what it holds to.
CHECKS = [
    ("fast", checks_drives.fast, True, "2000 real frames as fast as they are answered"),
    ("guarded", checks_drives.guarded, True, "150 real frames at 15 a second, with a network that brakes beside the pilot"),
    ("run-file", checks_runs.run_file, True, "the run of `fast` by stock mcap packages"),
    ("schemas", checks_runs.schemas, False, "every message of runs of all kinds is as the schema beside it says"),
    ("steady", checks_drives.steady, True, "60 s at 60 frames a second"),
    ("many", checks_drives.many, True, "8 simulators at once"),
    ("cultures", checks_drives.cultures, True, "numbers of four cultures"),
    ("late-start", checks_drives.late_start, True, "a simulator that missed its start is kicked"),
    ("human", checks_drives.human, True, "a human takes over and lets go"),
    ("replay", checks_drives.replay, True, "a replay in process and over the bridge agree"),
    ("simulate", checks_simulate.simulate_serve, False, "the headless simulator drives against our bridge"),
    ("drive.py", checks_simulate.simulate_drive_py, False, "and against python-socketio 4 on eventlet, as drive.py"),
    ("crash", checks_runs.crash, True, "kill -9 costs at most the last second of a run"),
    ("signals", checks_runs.signals, True, "SIGTERM and SIGINT leave whole runs"),
    ("perception", checks_models.perception, False, "pictures as OpenCV and Pillow make them, to the byte"),
    ("keras", checks_models.keras, False, "a network of tf.keras by ONNX and by safetensors answers as at home"),
    ("torch", checks_models.torch, False, "and one of PyTorch, by safetensors, TorchScript and ONNX"),
    ("report", checks_page.report, False, "the pages of scores and suites, and a film, in a browser: cursor, zoom, sorting, links"),
    ("live-serve", checks_live.live_serve, False, "the live page of a bridge in a browser: values, controls, tabs"),
    ("live-60-hz", checks_live.live_60_hz, True, "and that page at 60 telemetries a second: frames of the screen, long tasks, the newest turn"),
    ("live-drive", checks_live.live_drive, False, "and of the headless simulator: pause, step, reset, another world, runs"),
    ("live-record", checks_live.live_record, False, "and what is driven there by keys and gamepad is training data"),
    ("foxglove", checks_viewers.foxglove, False, "a drive as it happens and its run, by Foxglove's own schemas"),
    ("lichtblick", checks_viewers.lichtblick, False, "the client that Lichtblick is built on"),
    ("rerun", checks_viewers.rerun, False, "Rerun opens a run: pictures, log, where the car is"),
    ("abuse", checks_server.abuse, False, "malformed messages get one safe answer each"),
    ("unknown-agent", checks_server.unknown_agent, False, "a build that talks first is a simulator"),
    ("busy-port", checks_server.busy_port, False, "a taken port names who holds it"),
    ("redial-storm", checks_server.redial_storm, False, "2000 dials, few log lines"),
    ("rough", rough.rough, False, "a good simulator beside everybody who treats the port badly"),
    ("python-socketio", checks_clients.python_socketio, False, "python-socketio 5 and 4"),
    ("socket.io-client", checks_clients.js_socketio, False, "socket.io-client 4 and 2"),
]

# Checks that install, compute or wait, and may take any time, in the order in which they are begun: those that compute
# beside those that wait.
BESIDE = ("torch", "live-drive", "keras", "python-socketio", "report", "foxglove", "schemas", "simulate", "drive.py", "lichtblick", "rerun",
          "perception", "live-record", "socket.io-client")


def outcome(check, needs_shared, quick):
    """Makes a check; returns the word for its outcome and the figures."""
    try:
        if needs_shared and not FRAMES.is_dir():
            if REQUIRE_SHARED:
                raise Failed(f"the shared folder: expected recordings at {SHARED}, got none")
            raise Skipped("needs the shared folder")
        return "ok", check(quick)
    except Skipped as why:
        return "skipped", str(why)
    except Failed as why:
        return "FAILED", str(why)
    except Exception as why:  # a helper that hangs, an answer without a field: the other checks go on
        return "FAILED", f"{type(why).__name__}: {why}"


def make(name, check, needs_shared, quick):
    """Runs a check; returns its name, the word for its outcome, the figures on one line, and the seconds it took."""
    began = time.monotonic()
    word, figures = outcome(check, needs_shared, quick)
    return name, word, " ".join(figures.split()), time.monotonic() - began


def made(beside, alone, jobs):
    """The outcome of each check as it ends: first of those that may run side by side, then of the others."""
    pool = concurrent.futures.ThreadPoolExecutor(jobs)
    try:
        for done in concurrent.futures.as_completed([pool.submit(make, *check) for check in beside]):
            yield done.result()
    finally:
        pool.shutdown(cancel_futures=True)
    for check in alone:
        yield make(*check)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", metavar="NAME", choices=[c[0] for c in CHECKS], help="this check, repeatable")
    parser.add_argument("--quick", action="store_true", help="shorten the checks that take time")
    parser.add_argument("--jobs", type=int, choices=range(1, 9), default=2, metavar="N", help="how many checks that measure no time run at once (default 2)")
    parser.add_argument("--browser", choices=list(checks_live.NAMES), default="chromium", help="in which the pages are looked at")
    parser.add_argument("--list", action="store_true", help="say what there is")
    arguments = parser.parse_args()
    if arguments.list:
        for name, _, _, what in CHECKS:
            print(f"{name:17} {what}")
        return 0
    if not LAPWING.exists():
        sys.exit(f"expected the bridge at {LAPWING}, got nothing there: cargo build --release")
    ENVIRONMENT["INTEROP_BROWSER"] = arguments.browser
    shutil.rmtree(RUNS, ignore_errors=True)
    RUNS.mkdir(parents=True)
    counts = dict(ok=0, FAILED=0, skipped=0)
    chosen = {name: (name, check, needs_shared, arguments.quick) for name, check, needs_shared, _ in CHECKS
              if not arguments.only or name in arguments.only}
    beside = [chosen.pop(name) for name in BESIDE if name in chosen] if arguments.jobs > 1 else []
    for name, word, figures, took_s in made(beside, list(chosen.values()), arguments.jobs):
        counts[word] += 1
        print(f"{name:17} {word:7} {figures}  [{took_s:.1f} s]", flush=True)
    skipped = f", {counts['skipped']} skipped" if counts["skipped"] else ""
    print(f"{counts['ok']} passed, {counts['FAILED']} failed{skipped}")
    return 1 if counts["FAILED"] else 0


if __name__ == "__main__":
    sys.exit(main())
