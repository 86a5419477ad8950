"""How trainings compare: their validations over samples and over time, several seeds together."""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.ticker import (
    EngFormatter,
    Formatter,
    LogLocator,
    NullFormatter,
    StrMethodFormatter,
)

from wisar_planner.errors import InvalidInput
from wisar_planner.evaluation.palette import looks
from wisar_planner.training.algorithms import algorithm_of, last_policy, load_run
from wisar_planner.training.judging import fly_problems
from wisar_planner.training.problems import random_problems
from wisar_planner.training.records import Validation, read_counters
from wisar_planner.training.streams import fresh_generator
from wisar_planner.training.worlds import WorldDistribution

#: Mean probability efficiency on the paper's setup that a training is timed to.
GOAL = 0.28


@dataclass(frozen=True)
class TrainingCurve:
    """The validations of one run.

    Attributes
    ----------
    policy : str
        What was trained: the configuration's name, and what it leaves out.
    seed : int
        Its seed.
    validations : sequence of Validation
        In the order of the training; at least one.
    fresh_share : float, optional
        Mean share of the bound on fresh maps, where the run's last policy was flown there.
    fresh_by_raster : bool
        Whether that is by the raster of training, which tells a little less than the exact seen
        probability.
    config : mapping
        The configuration; runs of one policy that differ in more than the seed are compared.
    """

    policy: str
    seed: int
    validations: Sequence[Validation]
    fresh_share: float | None = None
    fresh_by_raster: bool = False
    config: Mapping[str, Any] = field(default_factory=dict)

    @property
    def best(self) -> Validation:
        """The validation whose policy is kept."""
        paper_share = self.config.get("worlds", {}).get("paper_share", 1.0)
        return max(self.validations, key=lambda each: each.score(paper_share))

    @property
    def minutes_to_goal(self) -> float | None:
        """Training time until the first validation at `GOAL`, minutes; None where none was."""
        reached = (each.seconds for each in self.validations if each.efficiency >= GOAL)
        seconds = next(reached, None)
        return None if seconds is None else seconds / 60.0


def read_curve(folder: Path) -> TrainingCurve:
    """Return the curve that a run left in its folder.

    Raises
    ------
    InvalidInput
        When the folder holds no checkpoint that can be read, none with a validation, or one of an
        unknown algorithm.
    """
    counters = read_counters(folder)
    config = counters["config"]
    # An improvement begins where another training ended: it is a line of its own.
    parts = [
        config["name"],
        algorithm_of(config, str(folder)).words,
        config.get("ablation", "").replace("_", " "),
    ]
    return TrainingCurve(
        policy=", ".join(filter(None, parts)),
        seed=config["seed"],
        validations=[Validation(**each) for each in counters["validations"]],
        config=config,
    )


def fly_fresh_maps(
    curve: TrainingCurve,
    folder: Path,
    maps: int,
    on_flown: Callable[[int], None] | None = None,
) -> TrainingCurve:
    """Return the curve of a run with the share of the bound of its last policy on fresh maps.

    It is flown as plans fly it and judged by the exact seen probability, however the run itself
    judges its policies. Ablations and the paper's policy, which no planner can fly, are flown in
    the environment that they were trained in; the paper's is judged by its raster.

    Parameters
    ----------
    curve : TrainingCurve
        The run's curve.
    folder : Path
        The run's folder.
    maps : int
        Number of maps of the paper's setup, the same ones for every run but the paper's. They
        chose nothing: neither training nor validation meets them.
    on_flown : callable, optional
        Told how many more maps were flown.

    Raises
    ------
    InvalidInput
        When the number of maps is below 1 or the run's checkpoint cannot be read.
    """
    if maps < 1:
        raise InvalidInput(f"the number of fresh maps must be at least 1, not {maps}")
    told = on_flown or (lambda _: None)
    device = torch.device("cpu")
    generator, model = fresh_generator(device), last_policy(folder)
    by_raster = False
    if model is None:
        flights = load_run(folder, device).judge(maps, generator, told)
        shares, by_raster = flights.share.tolist(), not flights.exact
    else:
        shares = []
        for _, share in fly_problems(
            random_problems(maps, 0, WorldDistribution(), generator), model
        ):
            shares.append(share)
            told(1)
    return dataclasses.replace(curve, fresh_share=_mean(shares), fresh_by_raster=by_raster)


def check_seeds(curves: Sequence[TrainingCurve]) -> None:
    """Check that runs of one configuration differ in their seeds, whose spread the table tells.

    Raises
    ------
    InvalidInput
        When two have the same.
    """
    for policy, runs in _by_configuration(curves).items():
        seeds = [run.seed for run in runs]
        if twice := sorted({seed for seed in seeds if seeds.count(seed) > 1}):
            raise InvalidInput(
                f"{policy}: there are {seeds.count(twice[0])} runs of seed {twice[0]}, whose "
                "spread would be taken for that of seeds; name one of them"
            )


def markdown(curves: Sequence[TrainingCurve]) -> str:
    """Return a table with a line per configuration, the best first; ± is the spread over seeds."""
    lines = [
        f"| policy | seeds | steps | minutes | minutes to e_p {GOAL} | e_p | share of the bound |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    flown = all(curve.fresh_share is not None for curve in curves)
    if flown:
        lines = [f"{lines[0]} of the last, on fresh maps |", f"{lines[1]} ---: |"]
    groups = _by_configuration(curves)
    for policy in sorted(groups, key=lambda name: -_mean(c.best.share for c in groups[name])):
        runs = groups[policy]
        last = [run.validations[-1] for run in runs]
        reached = [run.minutes_to_goal for run in runs if run.minutes_to_goal is not None]
        goal = f"{_mean(reached):.1f}" if len(reached) == len(runs) else "not reached"
        lines.append(
            f"| {policy} | {len(runs)} | {_mean(each.steps for each in last):,.0f} "
            f"| {_mean(each.seconds for each in last) / 60.0:.1f} | {goal} "
            f"| {_spread([run.best.efficiency for run in runs], '{:.4f}')} "
            f"| {_spread([100.0 * run.best.share for run in runs], '{:.1f}')}% |"
        )
        if flown:
            shares = [100.0 * run.fresh_share for run in runs if run.fresh_share is not None]
            raster = " by the raster" if runs[0].fresh_by_raster else ""
            lines[-1] += f" {_spread(shares, '{:.1f}')}%{raster} |"
    return "\n".join(lines) + "\n"


def draw(curves: Sequence[TrainingCurve]) -> Figure:
    """Return the share of the bound over samples and over time, a line per run."""
    figure = Figure(figsize=(9.6, 4.2), layout="constrained")
    groups = _by_configuration(curves)
    styles = looks(list(groups))
    views: tuple[tuple[str, Callable[[Validation], float], Formatter], ...] = (
        ("steps flown", lambda each: each.steps, EngFormatter(sep="")),
        ("training time, min", lambda each: each.seconds / 60.0, StrMethodFormatter("{x:g}")),
    )
    for axes, (label, along, numbers) in zip(figure.subplots(1, 2), views, strict=True):
        for policy, runs in groups.items():
            for i, run in enumerate(runs):
                # What an improvement begins with has no place on a logarithmic axis.
                trained = [each for each in run.validations if each.steps > 0]
                axes.plot(
                    [along(each) for each in trained],
                    [100.0 * each.share for each in trained],
                    color=styles[policy].colour,
                    linestyle=styles[policy].dash,
                    linewidth=1.3,
                    marker="o",
                    markersize=2.5,
                    label=policy if i == 0 else None,
                )
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(numbers)
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlabel(label)
        axes.grid(alpha=0.3)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    figure.axes[0].set_ylabel("share of the bound on the validation maps, %")
    figure.axes[0].legend(frameon=False, fontsize=8, loc="lower right")
    return figure


def _by_configuration(curves: Sequence[TrainingCurve]) -> dict[str, list[TrainingCurve]]:
    """Return runs that differ in the seed alone, by their policy and what else tells them apart."""
    policies: dict[str, list[TrainingCurve]] = {}
    for curve in curves:
        policies.setdefault(curve.policy, []).append(curve)
    groups: dict[str, list[TrainingCurve]] = {}
    for policy, runs in policies.items():
        fields = [_fields_without_seed(run, runs) for run in runs]
        for run, what in zip(runs, _differences(fields), strict=True):
            groups.setdefault(", ".join(filter(None, (policy, what))), []).append(run)
    return groups


def _fields_without_seed(curve: TrainingCurve, runs: Sequence[TrainingCurve]) -> dict[str, Any]:
    """Return the values of a run's configuration, without what differs from seed to seed."""
    fields = dict(_flat(curve.config))
    fields.pop("seed", None)
    start = fields.get("start")
    if start and not any(
        run.config.get("start") == start for run in runs if run.seed != curve.seed
    ):
        # Each seed of an improvement starts from the run of the same seed, out/train/sac-SEED.
        own = f"-{curve.seed}"
        fields["start"] = str(Path(*(part.removesuffix(own) for part in Path(start).parts)))
    return fields


def _flat(config: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the names, in words, and values of a configuration and those inside it."""
    for name, value in config.items():
        words = f"{above}{name.replace('_', ' ')}"
        if isinstance(value, Mapping):
            yield from _flat(value, f"{words} ")
        else:
            yield words, value


def _differences(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return in a few words what tells each run's fields from the others', as far as they differ.

    The first fields that tell all apart are named, and further ones that differ are counted.
    """
    names = dict.fromkeys(name for run in runs for name in run)
    told = {name: [_told(name, run.get(name)) for run in runs] for name in names}
    differing = [name for name in names if len(set(told[name])) > 1]
    shown: list[str] = []
    kinds = 1
    for name in differing:
        finer = len(set(zip(*(told[each] for each in (*shown, name)), strict=True)))
        if finer > kinds:
            shown.append(name)
            kinds = finer
    more = len(differing) - len(shown)
    rest = f" and {more} more" if more else ""
    return [", ".join(told[name][i] for name in shown) + rest for i in range(len(runs))]


def _told(name: str, value: Any) -> str:
    """Return a field and its value in words."""
    if value is None or value == "":
        return f"no {name}"
    number = isinstance(value, int) and not isinstance(value, bool)
    return f"{name} {value:,}" if number else f"{name} {value}"


def _mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))


def _spread(values: Sequence[float], form: str) -> str:
    mean = form.format(statistics.mean(values))
    return f"{mean} ± {form.format(statistics.stdev(values))}" if len(values) > 1 else mean
