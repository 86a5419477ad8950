"""`wisar train`: train a search policy, or improve a trained one."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wisar_planner.training.records import Validation
    from wisar_planner.training.run import Run

_EXAMPLES = """\
examples:
  wisar train config/sac.yaml --out out/sac
      a policy by soft actor-critic; Ctrl-C and the same command again continues where it stopped
  wisar train config/improvement.yaml --start out/sac/sac.safetensors --out out/improved
      a trained policy made better by policy iteration, on a CPU
  wisar train config/ppo.yaml --start out/improved/sac.safetensors --device cuda --out out/ppo
      a trained policy made better by proximal policy optimisation on a GPU
  wisar train config/expert_iteration.yaml --start out/ppo/sac.safetensors --out out/expert
      a trained policy that learns from search, on a CPU, as the shipped one did at last (then
      with config/expert_iteration_wide.yaml, which needs two such runs)
  wisar train config/sac.yaml --seed 1 --steps 100000 --out out/quick --threads 1
      another seed, shorter, on one core
  wisar train config/sac.yaml --device cuda --out out/gpu
      on a GPU
  wisar train config/sac.yaml --ablation mlp --out out/mlp
      without one of its parts, see docs/policy.md
  wisar train config/paper_sac.yaml --out out/paper
      the paper's own policy
  tensorboard --logdir out
      the curves, live; `wisar curves out/*` compares runs

The best policy by validation is out/.../sac.safetensors with its card sac.json; plan with it by
`wisar plan ... --planner sac --option model=out/sac/sac.safetensors`."""


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "train",
        help="train a search policy, or improve a trained one",
        description="Train a search policy by soft actor-critic, or improve a trained one by "
        "policy iteration, proximal policy optimisation or expert iteration, as the configuration "
        "says.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("config", type=Path, help="YAML file, for example config/sac.yaml")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of the run (default: out/train/FILE-SEED, so out/train/sac-0 for sac.yaml)",
    )
    parser.add_argument("--seed", type=int, metavar="S", help="seed instead of the file's")
    parser.add_argument("--steps", type=int, metavar="N", help="steps instead of the file's")
    parser.add_argument(
        "--ablation", metavar="NAME", help="part to leave out, e.g. mlp or no_step_gain"
    )
    parser.add_argument(
        "--start",
        metavar="MODEL",
        help="policy to improve (improvement.yaml, ppo.yaml, expert_iteration.yaml)",
    )
    parser.add_argument("--device", default="cpu", help="cpu (default) or cuda")
    parser.add_argument(
        "--threads", type=int, default=0, metavar="N", help="CPU threads (default: all cores)"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the learning curve")
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Train, from the start or on from the folder's checkpoint."""
    from wisar_planner.cli.training_needs import checked_device, require

    require("training needs PyTorch", "torch")
    import torch

    from wisar_planner.errors import InvalidInput
    from wisar_planner.training.algorithms import make_run, read_any_config
    from wisar_planner.training.records import has_checkpoint

    if args.threads < 0:
        raise InvalidInput(f"--threads must be at least 1, or 0 for all cores, not {args.threads}")
    names = ("seed", "steps", "ablation", "start")
    given = {name: getattr(args, name) for name in names}
    config = read_any_config(args.config, **{k: v for k, v in given.items() if v is not None})
    if args.threads:
        torch.set_num_threads(args.threads)
    device = checked_device(args.device)
    # By the file, since configurations that improve a policy keep its name.
    folder = args.out or Path("out/train") / f"{args.config.stem}-{config.seed}"
    training = make_run(config, folder, device)
    if has_checkpoint(folder):
        training.load_checkpoint()
        print(f"continuing {folder} at {training.steps:,} of {config.steps:,} steps")
    _follow(training)
    if args.json:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        curve = [vars(each) for each in training.validations]
        args.json.write_text(json.dumps(curve, indent=1) + "\n", encoding="utf-8")
    model = folder / f"{config.name}.safetensors"
    kept = str(model) if model.exists() else "not kept, since it is an ablation"
    print(f"best policy: {kept}; {training.best_share:.1%} of the bound on the validation maps")
    return 0


def _follow(training: Run[Any]) -> None:
    """Train with a progress bar and a line for each validation."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Remaining

    console = Console(stderr=not sys.stdout.isatty(), highlight=False)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), Remaining())
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("training", total=training.config.steps, completed=training.steps)
        for result in training.train(lambda steps, _: bar.update(task, completed=steps)):
            print(_line(result), flush=True)


def _line(result: Validation) -> str:
    figures = result.figures
    detail = "".join(f"  {name} {value:.4g}" for name, value in figures.items())
    rate = result.updates / max(result.seconds, 1e-9)
    return (
        f"{result.seconds / 60.0:6.1f} min  {result.steps:>9,} steps  {result.updates:>7,} updates "
        f"({rate:.1f}/s)  e_p {result.efficiency:.4f}  of the bound {result.share:.4f}{detail}"
    )
