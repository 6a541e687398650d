#!/usr/bin/env python3
"""A million telemetries from four simulators in rough company: `make soak`.

    tests/interop/soak.py [--telemetries 1000000] [--simulators 4] [--seed 1]
                          [--bridge-kills 3] [--quick]

Each simulator (unity.py) takes over, pauses, freezes for up to a minute, leaves
ghosts, is killed and quits as its seed draws it; the bridge, too, is killed and
started again a few times in the first fifth. Half of the simulators speak as
the stock build, half as those that tell the truth. What must hold, or the exit
status is 1:

- no token is lost and none is too many, counted after each of these acts;
- no answer that the simulator would swallow;
- every run can be scored, and only those that a killed bridge left are cut off;
- memory is flat once the bridge is no longer killed: the last tenth's mean is
  within 16 MiB of the second tenth's.

It takes some twenty minutes on two cores. Runs are removed once they are
checked, for together they would fill ten gigabytes.
"""
import argparse
import json
import multiprocessing
import os
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import time

from bridge import ENVIRONMENT, LAPWING, RUNS, Bridge, Failed, resident_mb
from unity import Simulator

GROWTH_MB = 16
BATCH = 24  # runs to a call of `lapwing score`


def play(port, seed, superset, jpegs, sent, quick, target, results):
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        results.put(Simulator(port, seed, superset, jpegs, sent, quick).play(target))
    except BaseException as why:  # the soak must hear of it, whatever it is
        results.put({"broke": f"{type(why).__name__}: {why}"})
        raise


def pictures():
    """Frames of our own simulator, as JPEGs."""
    folder = RUNS / "frames"
    done = subprocess.run([LAPWING, "record", "--track", "lake", "--max-time", "8", "--out", folder], env=ENVIRONMENT,
                          capture_output=True, text=True)
    jpegs = [file.read_bytes() for file in sorted((folder / "IMG").glob("center_*.jpg"))]
    if len(jpegs) < 100:
        raise Failed(f"lapwing record: expected 100 frames or more, got {len(jpegs)}: {done.stderr[-300:]}")
    return jpegs


def free_port():
    """One that a bridge can be started on again after it was killed."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


class Runs:
    """What the bridges recorded: scored in batches, then removed."""

    def __init__(self):
        self.ended, self.cut, self.whole, self.frames, self.troubles = [], [], 0, 0, []
        self.told = set()

    def take(self, bridge):
        """The runs whose summaries have come since it was asked last."""
        for run in (summary["run"] for summary in bridge.said()):
            if run is None or run["not_recorded"] or run.get("error"):
                self.troubles.append(f"expected a whole run, got {run}")
            elif run["path"] not in self.told:
                self.told.add(run["path"])
                self.frames += run["frames"]
                self.ended.append(run["path"])

    def abandoned(self, bridge):
        """Those that a killed bridge was writing."""
        self.take(bridge)
        self.cut += [str(file) for file in bridge.recordings if str(file) not in self.told]

    def score(self, least=BATCH):
        while len(self.ended) >= max(least, 1):
            batch, self.ended = self.ended[:BATCH], self.ended[BATCH:]
            self.judge(batch, damaged=False)
            self.whole += len(batch)

    def judge(self, batch, damaged):
        done = subprocess.run([LAPWING, "score", "--json", *batch], env=ENVIRONMENT, capture_output=True, text=True)
        cards = {card["run"]: card["damaged"] for card in json.loads(done.stdout)["runs"]} if done.stdout else {}
        for path in batch:
            if path not in cards or cards[path] and not damaged:
                self.troubles.append(f"{path}: expected a run that can be scored, got {cards.get(path)}: {done.stderr[-300:]}")
            else:
                os.remove(path)  # what is wrong stays, to be looked at


class Memory:
    """Resident megabytes over time."""

    def __init__(self, bridge):
        self.pid, self.began, self.seen = bridge.process.pid, time.monotonic(), []

    def look(self):
        self.seen.append((time.monotonic() - self.began, resident_mb(self.pid)))
        return self.seen[-1][1]

    def tenth(self, n):
        end = self.seen[-1][0]
        return statistics.mean(mb for at, mb in self.seen if n / 10 * end <= at <= (n + 1) / 10 * end)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--telemetries", type=int, default=1_000_000)
    parser.add_argument("--simulators", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--bridge-kills", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="no freezes of a minute")
    a = parser.parse_args()
    jpegs, port = pictures(), free_port()
    context = multiprocessing.get_context("fork")
    sent, results, runs = context.Value("q", 0), context.Queue(), Runs()
    kills = [a.telemetries * (i + 1) // (5 * (a.bridge_kills + 1)) for i in range(a.bridge_kills)]
    target = -(-a.telemetries // a.simulators)
    players = [context.Process(target=play, args=(port, f"{a.seed}-{i}", i % 2 == 1, jpegs, sent, a.quick, target, results))
               for i in range(a.simulators)]
    began = printed = time.monotonic()
    accounts = []
    bridge = Bridge(port=port).__enter__()
    try:
        for player in players:
            player.start()
        memory = Memory(bridge)
        while len(accounts) < a.simulators:
            time.sleep(0.5)
            if bridge.process.poll() is not None:
                raise Failed(f"the bridge: expected to run, got exit {bridge.process.returncode}: {bridge.log[-500:]}")
            if kills and sent.value >= kills[0]:
                kills.pop(0)
                bridge.kill()
                runs.abandoned(bridge)
                bridge = Bridge(port=port).__enter__()
                memory = Memory(bridge)
            memory.look()
            runs.take(bridge)
            runs.score()
            while not results.empty():
                accounts.append(results.get())
            if time.monotonic() - printed > 30:
                printed = time.monotonic()
                print(f"{printed - began:6.0f} s {sent.value:9} telemetries, {runs.whole} runs, {memory.look():.1f} MiB", flush=True)
        bridge.stop()
        runs.take(bridge)
    finally:
        bridge.kill()
        for player in players:
            player.kill()
    runs.score(least=1)
    for path in runs.cut:
        runs.judge([path], damaged=True)
    return report(a, accounts, runs, memory, time.monotonic() - began)


def report(a, accounts, runs, memory, seconds):
    broken = [account["broke"] for account in accounts if "broke" in account]
    accounts = [account for account in accounts if "broke" not in account]
    total = lambda key: sum(account[key] for account in accounts)
    acts = {act: sum(account["acts"][act] for account in accounts) for act in accounts[0]["acts"]} if accounts else {}
    print(f"{total('telemetries')} telemetries of {a.simulators} simulators (seed {a.seed}) in {seconds:.0f} s, "
          f"{total('humans')} of them of humans, over {total('dials')} connections")
    print("  " + ", ".join(f"{count} x {act}" for act, count in acts.items()) + f", {a.bridge_kills} x bridge killed")
    second, last = memory.tenth(1), memory.tenth(9)
    print(f"  tokens counted {total('checks')} times; runs {runs.whole} whole, {len(runs.cut)} cut off by kills, "
          f"{runs.frames} frames in the whole ones; memory {second:.1f} MiB in the second tenth, {last:.1f} MiB in the last")
    troubles = broken + runs.troubles
    for kind in ("lost", "surplus", "swallowed"):
        troubles += [f"{kind}: {what}" for account in accounts for what in account[kind]]
    if last > second + GROWTH_MB:
        troubles.append(f"memory grew by {last - second:.1f} MiB")
    for trouble in troubles[:20]:
        print(f"  WRONG {trouble}")
    print(f"{len(troubles)} troubles")
    return 1 if troubles else 0


if __name__ == "__main__":
    shutil.rmtree(RUNS, ignore_errors=True)
    RUNS.mkdir(parents=True)
    try:
        sys.exit(main())
    except Failed as failure:
        sys.exit(f"FAILED: {failure}")
