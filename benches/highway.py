#!/usr/bin/env python3
"""What highway-env's intersection costs: the peer of `benches/intersection.rs`, on one core.

Four agents and other cars at an intersection without lights, actions at random. Counted are agent-steps a second, once with
highway-env's own settings (15 steps of simulation for each action, one action a second) and once as in Lapwing (ten actions a
second, two steps of simulation for each; about twelve other cars). It is run by hand, as its dependencies take 500 MB:

    python3 -m venv .venv-highway
    .venv-highway/bin/pip install highway-env==1.12.1
    taskset -c 0 .venv-highway/bin/python benches/highway.py
    taskset -c 0 cargo bench -- agent_steps                 # same machine, same hour
"""
import time

import gymnasium
import highway_env

SECONDS = 15
AGENTS = 4


def measure(name, changes):
    """Prints steps and agent-steps a second of wall and of processor time, and how many cars there were."""
    actions = {"type": "MultiAgentAction", "action_config": {"type": "DiscreteMetaAction", "lateral": False}}
    sees = {"type": "MultiAgentObservation", "observation_config": {"type": "Kinematics"}}
    config = {"controlled_vehicles": AGENTS, "action": actions, "observation": sees, **changes}
    env = gymnasium.make("intersection-v0", config=config)
    env.reset(seed=0)
    env.action_space.seed(0)
    steps, cars = 0, 0
    began, used = time.perf_counter(), time.process_time()
    while time.perf_counter() - began < SECONDS:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        steps += 1
        cars += len(env.unwrapped.road.vehicles) - AGENTS
        if terminated or truncated:
            env.reset()
    wall, used = time.perf_counter() - began, time.process_time() - used
    print(f"{name}: {steps / wall:.1f} steps/s, {AGENTS * steps / wall:.1f} agent-steps/s "
          f"({AGENTS * steps / used:.1f} a second of processor time), {cars / steps:.1f} other cars")


if __name__ == "__main__":
    print("highway-env", getattr(highway_env, "__version__", "?"))
    measure("as it comes", {})
    measure("as in Lapwing", {"policy_frequency": 10, "simulation_frequency": 20, "duration": 100,
                              "initial_vehicle_count": 14, "spawn_probability": 0.06})
