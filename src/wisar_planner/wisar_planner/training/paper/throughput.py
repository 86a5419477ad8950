"""How fast this machine trains the paper's policy.

python -m wisar_planner.training.paper.throughput config/paper_sac.yaml --threads 1
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch

from wisar_planner.errors import InvalidInput
from wisar_planner.training.paper.config import PaperConfig, read_paper_config
from wisar_planner.training.paper.run import PaperRun
from wisar_planner.training.records import hardware


def measure(config: PaperConfig, device: torch.device, seconds: float) -> dict[str, Any]:
    """Return what an update and a step of all environments take.

    Half of the time is given to updates, a quarter each to the environment alone and to the
    environment flown by the policy; each is done at least twice, after once that does not count.
    On a machine that does other work, too, the CPU's time of an update is the steadier figure.

    Parameters
    ----------
    config : PaperConfig
        What would be trained.
    device : torch.device
        Where to compute.
    seconds : float
        Time to measure for, s.
    """
    run = PaperRun(config, None, device)
    c, environment, generator = config, run.environment, run.generator

    def fly(by_policy: bool) -> None:
        if environment.flown == c.task.waypoints:
            environment.begin()
        if by_policy:
            environment.step(run.learner.act(environment.observe(), generator))
        else:
            environment.step(
                2.0 * torch.rand(c.environments, generator=generator, device=device) - 1
            )

    run.replay.begin(environment.means, environment.position)
    for _ in range(c.task.waypoints):
        action = 2.0 * torch.rand(c.environments, generator=generator, device=device) - 1.0
        run.replay.add(action, environment.step(action), environment.position)
    update, cpu = _mean_time(
        lambda: run.learner.update(run.replay.sample(c.sac.batch, generator), generator),
        0.5 * seconds,
        device,
    )
    random, _ = _mean_time(lambda: fly(False), 0.25 * seconds, device)
    policy, _ = _mean_time(lambda: fly(True), 0.25 * seconds, device)
    # Of the run as a whole: `train_every` steps of all environments, then `gradient_steps` updates.
    cycle = c.train_every * policy + c.gradient_steps * update
    rate = c.train_every * c.environments / cycle
    return {
        "hardware": hardware(device),
        "network": f"{c.network.layers} x {c.network.width}, {c.network.path_extractor}",
        "parameters": run.learner.parameters,
        "batch": c.sac.batch,
        "seconds_per_update": update,
        "cpu_seconds_per_update": cpu,
        "environment_steps_per_s": c.environments / random,
        "environment_steps_per_s_with_policy": c.environments / policy,
        "training_steps_per_s": rate,
        "days_for_all_steps": c.steps / rate / 86_400.0,
    }


def _mean_time(
    work: Callable[[], object], seconds: float, device: torch.device
) -> tuple[float, float]:
    """Return the mean time of repeated work and that of the CPU, of all threads, s."""

    def wait() -> None:
        if device.type == "cuda":
            torch.cuda.synchronize(device)

    work()
    wait()
    began, cpu_began, count = time.perf_counter(), time.process_time(), 0
    while count < 2 or time.perf_counter() - began < seconds:
        work()
        wait()
        count += 1
    wall, cpu = time.perf_counter() - began, time.process_time() - cpu_began
    return wall / count, cpu / count


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print the figures as JSON."""
    parser = argparse.ArgumentParser(description="Measure the speed of training.")
    parser.add_argument("config", type=Path, help="YAML file, for example config/paper_sac.yaml")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S")
    parser.add_argument("--threads", type=int, default=0, metavar="N", help="CPU threads")
    parser.add_argument("--device", default="cpu", help="cpu (default) or cuda")
    args = parser.parse_args(argv)
    if args.threads:
        torch.set_num_threads(args.threads)
    try:
        config = read_paper_config(args.config)
    except InvalidInput as error:
        print(error, file=sys.stderr)
        return 2
    print(json.dumps(measure(config, torch.device(args.device), args.seconds), indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
