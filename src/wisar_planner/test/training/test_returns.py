import pytest
import torch

from wisar_planner.training.returns import trace_returns


@pytest.mark.parametrize("trace", [0.0, 0.6, 1.0])
def test_returns_are_the_weighted_mean_of_all_n_step_returns(generator, trace) -> None:
    steps, ends = 6, 3  # the search in column 1 ends after the step of that number
    rewards = torch.rand(steps, 2, generator=generator)
    values = torch.rand(steps + 1, 2, generator=generator)
    dones = torch.zeros(steps, 2, dtype=torch.bool)
    dones[ends, 1] = True
    returns = trace_returns(rewards, dones, values, trace)
    for column, last in ((0, steps), (1, ends + 1)):
        for t in range(last):
            n_step = []
            for n in range(1, last - t + 1):
                bootstrap = 0.0 if column == 1 and t + n == last else values[t + n, column]
                n_step.append(rewards[t : t + n, column].sum() + bootstrap)
            weights = [(1 - trace) * trace**i for i in range(len(n_step) - 1)]
            weights.append(trace ** (len(n_step) - 1))
            expected = sum(w * float(g) for w, g in zip(weights, n_step, strict=True))
            assert float(returns[t, column]) == pytest.approx(expected, rel=1e-5)
