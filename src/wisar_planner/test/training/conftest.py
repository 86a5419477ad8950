import pytest
import torch

from wisar_planner.training import worlds as module
from wisar_planner.training.algorithms import make_run
from wisar_planner.training.worlds import WorldDistribution

#: Kinds of worlds that trainings draw.
KINDS = {
    "paper": WorldDistribution(),
    "varied": WorldDistribution(paper_share=0.0),
    "mixed": WorldDistribution(paper_share=0.5),
    "fields": WorldDistribution(paper_share=0.2, field_share=0.7),
    "narrow": WorldDistribution(
        paper_share=0.0, sides=(3.0, 5.0), modes=1, radii=(0.1, 1.0), budgets=(1, 4)
    ),
}


@pytest.fixture(params=KINDS)
def distribution(request):
    return KINDS[request.param]


@pytest.fixture
def generator():
    return torch.Generator().manual_seed(3)


@pytest.fixture
def trained():
    """A function that trains; one that is told to stops after some validations and goes on anew."""

    def train(config, folder, *, stop_after=None):
        run = make_run(config, folder, torch.device("cpu"))
        for count, _ in enumerate(run.train(), start=1):
            if count == stop_after:
                run = make_run(config, folder, torch.device("cpu"))
                run.load_checkpoint()
                assert len(run.validations) == stop_after
                assert run.steps == run.validations[-1].steps
                list(run.train())
                break
        return run

    return train


@pytest.fixture
def mixtures(monkeypatch):
    """Collect the mixtures of the worlds that are drawn: (weights, means, deviations, turn)."""
    drawn = []
    density = module._density

    def spy(side, *mixture):
        drawn.append([each.double().numpy() for each in mixture])
        return density(side, *mixture)

    monkeypatch.setattr(module, "_density", spy)
    return drawn


@pytest.fixture(autouse=True, scope="session")
def one_thread() -> None:
    """Small arrays gain nothing from threads, and the tests share the cores."""
    torch.set_num_threads(1)
