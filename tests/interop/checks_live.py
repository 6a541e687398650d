"""The live page in a real browser: of a bridge with two simulators, of `lapwing drive --page` and `record --page`."""
import json
import os
import re
import shutil
import signal
import subprocess

from bridge import (ENVIRONMENT, HERE, LAPWING, REQUIRE_SHARED, RUNS, Bridge, Failed, Skipped, Unity, equal, lapwing, node,
                    run_json, unharmed, wait_for, within)

NAMES = {"chromium": ("chromium", "chromium-browser", "google-chrome"), "firefox": ("firefox-esr", "firefox")}
NAMES["firefox-dark"] = NAMES["firefox"]  # Firefox cannot be switched, see browser.js


def browser():
    """Puts the program of the browser that `run.py --browser` names into the environment; browser.js starts it."""
    which = ENVIRONMENT.setdefault("INTEROP_BROWSER", "chromium")
    found = next(filter(None, map(shutil.which, NAMES[which])), None)
    if not found:
        if REQUIRE_SHARED:
            raise Failed(f"{which}: expected one of {', '.join(NAMES[which])} on the PATH, got none")
        raise Skipped(f"no {which} is on the PATH")
    ENVIRONMENT["INTEROP_BROWSER_PATH"] = found


def look(url, mode):
    """Runs live.js against a page; its screenshots lie in `target/interop/runs/live`."""
    program, folder = node()
    shots = RUNS / "live"
    shots.mkdir(parents=True, exist_ok=True)
    browser()
    return run_json([program, HERE / "live.js", url, mode, shots], folder, timeout=420)


class Program:
    """A verb in the background as a context; SIGINT ends it."""

    def __init__(self, name, *arguments):
        self.dir = RUNS / name
        self.dir.mkdir(parents=True, exist_ok=True)
        self.command = [LAPWING, *map(str, arguments)]

    def __enter__(self):
        with open(self.dir / "stdout", "wb") as out, open(self.dir / "stderr", "wb") as err:
            self.process = subprocess.Popen(self.command, cwd=self.dir, env=ENVIRONMENT, stdin=subprocess.DEVNULL,
                                            stdout=out, stderr=err)
        return self

    def __exit__(self, *_):
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(20)
        finally:
            self.process.kill()

    @property
    def log(self):
        return (self.dir / "stderr").read_text(errors="replace")


def live_serve(_):
    browser()
    node()
    other = HERE.parent.parent / "models" / "pilotnet.safetensors"
    with Bridge("--speed", "12", "--also-model", other) as bridge:
        play = ("simulate", "--connect", f"127.0.0.1:{bridge.port}", "--realtime", "--laps", "50", "--on-crash", "reset")
        with Program("live-one", *play), Program("live-two", *play, "--track", "jungle", "--stock"):
            result = look(f"http://127.0.0.1:{bridge.port}/", "serve")
    runs = [summary for summary in bridge.summaries if summary["run"]]
    equal("runs: two simulators, of which one had two", len(runs), 3)
    return f"{result['events']} events shown, at most {result['behind']} turns behind"


def live_60_hz(quick):
    """What the page itself does, counted, and compared with the same page idle before and after: how fast the machine is, and
    what else it does, is no part of it."""
    browser()
    if ENVIRONMENT["INTEROP_BROWSER"] != "chromium":
        raise Skipped("only Chromium tells of long tasks, and how long a page's thread works")
    program, folder = node()
    seconds, fps = 4 if quick else 8, 60
    with Bridge("--no-recording") as bridge:
        looks = [program, HERE / "jank.js", f"http://127.0.0.1:{bridge.port}/", str(seconds)]
        looking = subprocess.Popen(looks, cwd=folder, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            equal("jank.js, once the page is open and idle", looking.stdout.readline(), "ready\n")
            count = fps * (seconds + 8)
            unharmed(Unity(bridge, "--fps", fps, "--count", count, "--seconds", 120).result(180))
            out, err = looking.communicate(timeout=180)
        finally:
            looking.kill()
    if looking.returncode:
        raise Failed(f"jank.js: {err.strip()[-300:]}")
    told = json.loads(out)
    driven, stalled, idle = told["driven"], told["stalled"], (told["before"], told["after"])
    # Each turn is shown, or a newer one in its place: at most once a frame of the screen, and never an older one.
    within("draws", driven["draws"], min(driven["turns"], driven["frames"]) / 2, driven["frames"] + 1)
    equal("second draws within a frame of the screen", driven["twice"], 0)
    equal("draws of a turn that was not the newest", driven["old"], 0)
    equal("pictures decoded at a time", driven["together"], 1)
    within("turns per moment that came while the page did not listen", stalled["turns"] / stalled["moments"], 3)
    # And the screen is drawn nearly as often as if nothing were driven: bridge, simulator and browser share the cores.
    rate = lambda seen: seen["frames"] / seen["passed"]
    within("frames of the screen per second", rate(driven), 0.5 * min(map(rate, idle)))
    within("long tasks", driven["long"], 0, max(seen["long"] for seen in idle) + driven["frames"] / 20)
    share = driven["busy"] / driven["passed"]
    within("share of the time that the page's thread works", share, 0, 0.5)
    return (f"{driven['turns'] / driven['passed']:.0f} turns, {driven['draws'] / driven['passed']:.0f} draws and {rate(driven):.0f} "
            f"frames a second ({rate(idle[0]):.0f} idle), {driven['long']} long tasks, {100 * share:.0f} % of the page's thread")


def live_drive(_):
    browser()
    node()
    with Program("live-drive", "drive", "--page", "0", "--track", "lake", "--on-crash", "reset", "--recordings", "runs") as drive:
        found = wait_for("the page's address", 60, lambda: re.search(r"Page: (http://127\.0\.0\.1:\d+/)", drive.log))
        result = look(found[1], "drive")
    equal("exit status after SIGINT", drive.process.returncode, 0)
    runs = len(list((drive.dir / "runs").glob("*.mcap")))
    equal("runs: the first, after the reset, the jungle with a car ahead and without", runs, 4)
    equal("what was downloaded", result["downloaded"].endswith(".mcap"), True)
    return f"{result['events']} events shown, {runs} runs, two of them played; {result['agreement']}"


def live_record(_):
    browser()
    node()
    with Program("live-record", "record", "--page", "0", "--speed", "12", "--out", "data") as recorder:
        found = wait_for("the page's address", 60, lambda: re.search(r"Page: (http://127\.0\.0\.1:\d+/)", recorder.log))
        result = look(found[1], "record")
    equal("exit status after SIGINT", recorder.process.returncode, 0)
    folder = recorder.dir / "data"
    rows = [line.split(",") for line in (folder / "driving_log.csv").read_text().splitlines()]
    equal("rows of the log", len(rows), result["rows"])
    equal("rows without three pictures", [row for row in rows if not all(map(os.path.isfile, row[:3]))], [])
    equal("a row with full throttle, one with the gamepad's half", [any(float(row[4]) == held for row in rows) for held in (1, 0.5)],
          [True, True])
    (found,) = lapwing("dataset", "inspect", folder, "--json")
    equal("rows that `dataset inspect` reads", found["rows"], len(rows))
    return f"{len(rows)} rows driven by keys and gamepad"
