#!/usr/bin/env python3
"""Does a page slow the drive down? The bridge's latency without a page, beside a reader that keeps up, beside one that
reads nothing, beside Chromium, and beside readers of what the network looks at, in one run of the bridge. Run by hand: the machine should do nothing else.

    tests/interop/beside_page.py [--seconds 20] [--fps 60] [--rounds 2] [--only NAME …]

Prints p50, p95 and p99 of the answers, as the bridge's own summary has them, for each round.
"""
import argparse
import os
import subprocess
import sys
import time

from bridge import ENVIRONMENT, HERE, RUNS, Bridge, Failed, Unity, node, unharmed
from checks_live import browser


HOW = ("stall", "read", "chromium", "visual-back-prop", "integrated-gradients")


def beside(bridge, how, seconds, fps):
    """A drive beside such a page; returns how many moments the page got."""
    watcher = None
    if how:
        program, folder = node()
        browser()
        watcher = subprocess.Popen([program, HERE / "watch.js", f"http://127.0.0.1:{bridge.port}/", how], cwd=folder,
                                   env=ENVIRONMENT, stdout=subprocess.PIPE, text=True)
        if watcher.stdout.readline() != "ready\n":
            raise Failed(f"watch.js {how}: expected to be ready, got an end")
        time.sleep(1)
    try:
        count = int(seconds * fps)
        unharmed(Unity(bridge, "--fps", fps, "--count", count, "--seconds", 2 * seconds).result(3 * seconds + 60), count)
    finally:
        if watcher:
            watcher.terminate()
            moments = int(watcher.communicate(timeout=20)[0] or 0)
    return moments if watcher else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--fps", type=int, default=60)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--only", action="append", choices=HOW, help="this page, repeatable")
    a = parser.parse_args()
    rows = []
    with Bridge("--no-recording") as bridge:
        for _ in range(a.rounds):
            for how in (None, *(a.only or HOW)):
                rows.append((how, beside(bridge, how, a.seconds, a.fps)))
    for (how, moments), summary in zip(rows, bridge.summaries):
        answer = summary["latency_ms"]["answer"]
        page = f"{moments} {'layers' if '-' in (how or '') else 'moments'} shown" if how else ""
        print(f"{how or 'no page':20} p50 {answer['p50']:.2f}  p95 {answer['p95']:.2f}  p99 {answer['p99']:.2f} ms  {page}")
    print(f"load of the machine at the end: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    RUNS.mkdir(parents=True, exist_ok=True)
    try:
        sys.exit(main())
    except Failed as failure:
        sys.exit(f"FAILED: {failure}")
