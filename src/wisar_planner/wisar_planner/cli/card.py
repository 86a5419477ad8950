"""`wisar card`: evaluate a trained policy on fresh maps and write the result in its card."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

_EXAMPLES = """\
examples:
  wisar card models/sac.safetensors --runs 1000
      what the policy alone reaches on maps that neither trained nor chose it"""

#: Maps whose mean stands in the card for a quick check of an installation.
_CHECK_RUNS = 32


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "card",
        help="evaluate a trained policy and write the result in its card",
        description="Evaluate a trained policy alone on the paper's setup, and write the result in "
        "the model card beside its weights.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("model", type=Path, help="the weights, a .safetensors file")
    parser.add_argument("--runs", type=int, default=1000, metavar="N", help="maps (default: 1000)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed (default: 0)")
    parser.add_argument(
        "--jobs", type=int, default=-1, metavar="N", help="processes (default: all)"
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Evaluate and write."""
    import numpy as np

    from wisar_planner.errors import InvalidInput
    from wisar_planner.evaluation.run import PlannerSpec
    from wisar_planner.evaluation.runner import Evaluation, run_evaluation
    from wisar_planner.evaluation.statistics import bootstrap_ratio, standard_deviation
    from wisar_planner.policy.model import load_model

    model = load_model(args.model)
    spec = PlannerSpec("sac", {"model": str(args.model.resolve())})
    if args.runs < _CHECK_RUNS:
        raise InvalidInput(f"--runs must be at least {_CHECK_RUNS}, not {args.runs}")
    records = run_evaluation(Evaluation([spec], args.runs, args.seed, persons=1), jobs=args.jobs)
    reached = np.array([record.e_p for record in records])
    bounds = np.array([record.bound for record in records])
    mean, share = bootstrap_ratio(reached), bootstrap_ratio(reached, bounds)
    model.card["evaluation"] = {
        "command": f"wisar card {args.model} --runs {args.runs} --seed {args.seed}",
        "setup": "the paper's, start uniform in the area",
        "maps": args.runs,
        "seed": args.seed,
        "e_p_mean": round(float(mean.value), 5),
        "e_p_std": round(standard_deviation(reached), 5),
        "e_p_95": [round(float(mean.low), 5), round(float(mean.high), 5)],
        "share_of_bound": round(float(share.value), 5),
        "share_of_bound_95": [round(float(share.low), 5), round(float(share.high), 5)],
        "check": {"maps": _CHECK_RUNS, "e_p_mean": round(float(reached[:_CHECK_RUNS].mean()), 5)},
    }
    args.model.with_suffix(".json").write_text(
        json.dumps(model.card, indent=2) + "\n", encoding="utf-8"
    )
    print(
        f"e_p {float(mean.value):.4f} (95%: {float(mean.low):.4f} to {float(mean.high):.4f}), "
        f"{float(share.value):.1%} of the bound, on {args.runs} maps; written in "
        f"{args.model.with_suffix('.json')}"
    )
    return 0
