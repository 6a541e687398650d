#!/usr/bin/env python3
"""`make drive`: a first drive without the simulator at hand.

Starts `lapwing serve` (on 4567, as for the real simulator, or on a free port
where that one is taken), plays the shipped recording to it as the simulator
would, stops it with Ctrl-C's signal and says where the new run lies.

Python 3.8 or newer, nothing else. Exit status: that of the first part that
failed, 130 after Ctrl-C.
"""
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LAPWING = ROOT / "target" / "release" / "lapwing"
SHIPPED = Path("recordings") / "plain-road.mcap"
RUNS = Path("runs")  # git ignores it
FRAMES_PER_S = "30"
LOADING = 30  # seconds that the model may take


def main():
    for needed in (LAPWING, ROOT / SHIPPED):
        if not needed.exists():
            sys.exit(f"expected {needed.relative_to(ROOT)}, got nothing there: is this a whole checkout, and built (make build)?")
    before = set((ROOT / RUNS).glob("*.mcap"))
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log"
        # In a session of its own: Ctrl-C comes to this script only, which then ends the bridge once.
        with open(log, "w") as stderr:
            serve = subprocess.Popen([LAPWING, "serve", "--port", free_port(), "--recordings", RUNS], cwd=ROOT,
                                     stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=stderr,
                                     start_new_session=True, text=True)
        try:
            address = ready(serve, log)
            print(f"a bridge waits on {address}; the recording {SHIPPED} is played to it\n", flush=True)
            replay = subprocess.run([LAPWING, "replay", SHIPPED, "--connect", address, "--rate", FRAMES_PER_S], cwd=ROOT)
            print(flush=True)
        finally:
            if serve.poll() is None:
                serve.send_signal(signal.SIGINT)
            print(serve.communicate()[0].rstrip(), flush=True)  # closes the run, then prints its summary
        if replay.returncode or serve.returncode:
            print(f"\nthe bridge said:\n{log.read_text()}", file=sys.stderr)
            return replay.returncode or serve.returncode
    new = sorted(set((ROOT / RUNS).glob("*.mcap")) - before)
    if not new:
        sys.exit(f"expected a new run in {RUNS}, got none")
    run = new[-1].relative_to(ROOT)
    print(f"\nThe new run: {run}. Look at it with `{LAPWING.relative_to(ROOT)} replay {run}`, or open it in Foxglove.")
    return 0


def free_port():
    """The simulator's own port; 0, any free one, where that is taken."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", 4567))
        except OSError:
            print("port 4567 is taken; another one will do", file=sys.stderr)
            return "0"
    return "4567"


def ready(serve, log):
    """Waits until the bridge listens and its model is loaded; returns its address."""
    end = time.monotonic() + LOADING
    while serve.poll() is None and time.monotonic() < end:
        said = log.read_text()
        address = re.match(r"Lapwing waits for a simulator on (\S+:\d+)\.", said)
        if address and "model:" in said:
            return address[1]
        time.sleep(0.05)
    sys.exit(f"expected the bridge to be ready within {LOADING} s, got:\n{log.read_text()}")


def interrupt(*_):
    raise KeyboardInterrupt


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, interrupt)
    signal.signal(signal.SIGHUP, interrupt)  # a closed terminal
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
