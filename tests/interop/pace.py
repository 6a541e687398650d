#!/usr/bin/env python3
"""Eight simulators at 15 Hz for ten minutes: does anybody miss a frame, does
memory stay flat? Run by hand, it is too long for CI.

    tests/interop/pace.py [--minutes 10] [--simulators 8] [--fps 15]

Prints the bridge's resident memory every ten seconds and, at the end, its mean
over the second minute and over the last. Exit status 1 where a frame was missed
or memory grew by more than 5% between the two.
"""
import argparse
import shutil
import sys
import time

from bridge import RUNS, Bridge, Failed, Unity, resident_mb


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--simulators", type=int, default=8)
    parser.add_argument("--fps", type=int, default=15)
    a = parser.parse_args()
    seconds = a.minutes * 60
    count = int(seconds * a.fps)
    memory = []
    with Bridge() as bridge:
        clients = [Unity(bridge, "--fps", a.fps, "--count", count, "--seconds", seconds * 1.02) for _ in range(a.simulators)]
        start = time.monotonic()
        while (at := time.monotonic() - start) < seconds:
            memory.append((at, resident_mb(bridge.process.pid)))
            print(f"{at:6.0f} s {memory[-1][1]:8.1f} MiB", flush=True)
            time.sleep(min(10, seconds - at))
        results = [client.result() for client in clients]
    folder = bridge.dir
    shutil.rmtree(folder / "mcap")  # a gigabyte of frames
    mean = lambda low, high: (lambda xs: sum(xs) / len(xs))([mb for at, mb in memory if low <= at < high])
    second, last = mean(seconds * 0.1, seconds * 0.2), mean(seconds * 0.9, seconds)
    least = min(r["telemetries"] for r in results)
    troubles = sum(r["stalls"] + len(r["deaths"]) + r["lost_tokens"] for r in results)
    lost = sum(s["run"]["not_recorded"] for s in bridge.summaries)
    p99 = max(s["latency_ms"]["answer"]["p99"] for s in bridge.summaries)
    print(f"{a.simulators} simulators: {least} of {count} telemetries at least, {troubles} troubles, {lost} items not recorded, "
          f"bridge p99 {p99:.2f} ms; memory {second:.1f} MiB in the second tenth, {last:.1f} MiB in the last")
    return 0 if least == count and not troubles and not lost and last <= 1.05 * second else 1


if __name__ == "__main__":
    RUNS.mkdir(parents=True, exist_ok=True)
    try:
        sys.exit(main())
    except Failed as failure:
        sys.exit(f"FAILED: {failure}")
