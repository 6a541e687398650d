#!/usr/bin/env python3
"""Lapwing's intersection beside highway-env's: four agents, an intersection without lights, actions at random, one core.

Both are measured in turns in one run: highway-env once with its own settings (15 steps of simulation for each action, one action a
second) and once as in Lapwing (ten actions a second, two steps of simulation for each; about twelve other cars), Lapwing by
`cargo bench -- agent_steps`. Printed are agent-steps a second, medians of the rounds with the slowest and the fastest, and the
ratios. It is run by hand, as its dependencies take 500 MB:

    python3 -m venv .venv-highway
    .venv-highway/bin/pip install highway-env==1.12.1
    .venv-highway/bin/python benches/highway.py
"""
import argparse
import os
import re
import statistics
import subprocess
import time

import gymnasium
import highway_env

AGENTS = 4
AS_IT_COMES, AS_HERE = "highway-env as it comes", "highway-env as in Lapwing"
SETTINGS = {
    AS_IT_COMES: {},
    AS_HERE: {"policy_frequency": 10, "simulation_frequency": 20, "duration": 100, "initial_vehicle_count": 14,
              "spawn_probability": 0.06},
}
ALONE, IN_TRAFFIC = "Lapwing without traffic", "Lapwing with 12 cars"
BENCH = ["cargo", "bench", "--bench", "driving"]
UNITS = {"": 1.0, "K": 1e3, "M": 1e6, "G": 1e9}


def highway(changes, seconds):
    """Agent-steps a second, and the mean number of other cars."""
    actions = {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction", "lateral": False}}
    sees = {"type": "MultiAgentObservation", "observation_config": {"type": "Kinematics"}}
    config = {"controlled_vehicles": AGENTS, "action": actions, "observation": sees, **changes}
    env = gymnasium.make("intersection-v0", config=config)
    env.reset(seed=0)
    env.action_space.seed(0)
    steps, cars, began = 0, 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        steps += 1
        cars += len(env.unwrapped.road.vehicles) - AGENTS
        if terminated or truncated:
            env.reset()
    return AGENTS * steps / (time.perf_counter() - began), cars / steps


def lapwing():
    """Agent-steps a second without traffic and with 12 cars: divan's medians."""
    text = subprocess.run([*BENCH, "--", "agent_steps"], check=True, capture_output=True, text=True).stdout
    found = [line for line in text.splitlines() if "item/s" in line]
    if len(found) != 2:
        raise SystemExit(f"expected two lines with item/s from `{' '.join(BENCH)} -- agent_steps`, got {len(found)}:\n{text}")
    rates = []
    for line in found:
        # fastest, slowest, median, mean
        columns = re.findall(r"([0-9.]+) ([KMG]?)item/s", line)
        number, unit = columns[2]
        rates.append(float(number) * UNITS[unit])
    return rates


def main():
    flags = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    flags.add_argument("--rounds", type=int, default=3)
    flags.add_argument("--seconds", type=float, default=10.0, help="of each of highway-env's measurements")
    flags = flags.parse_args()
    subprocess.run([*BENCH, "--no-run", "--quiet"], check=True)
    core = min(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})  # what is started from here stays there, too
    print(f"highway-env {getattr(highway_env, '__version__', '?')}, {flags.rounds} rounds on core {core}", flush=True)
    rates = {name: [] for name in [*SETTINGS, ALONE, IN_TRAFFIC]}
    cars = {}
    for _ in range(flags.rounds):
        for name, changes in SETTINGS.items():
            rate, cars[name] = highway(changes, flags.seconds)
            rates[name].append(rate)
        for name, rate in zip([ALONE, IN_TRAFFIC], lapwing(), strict=True):
            rates[name].append(rate)
    for name, found in rates.items():
        others = f", {cars[name]:.1f} other cars" if name in cars else ""
        print(f"{name}: {statistics.median(found):,.0f} agent-steps/s ({min(found):,.0f} to {max(found):,.0f}){others}")
    for name in SETTINGS:
        ratio = statistics.median(ours / theirs for ours, theirs in zip(rates[IN_TRAFFIC], rates[name], strict=True))
        print(f"{IN_TRAFFIC} against {name}: {ratio:,.0f} times")


if __name__ == "__main__":
    main()
