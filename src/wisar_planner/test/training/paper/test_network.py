import numpy as np
import pytest
import torch
from scipy import stats

from wisar_planner.errors import InvalidInput
from wisar_planner.training.paper.network import (
    PATH_EXTRACTORS,
    Actor,
    Critics,
    FeatureExtractor,
    NetworkSettings,
)
from wisar_planner.training.paper.observation import Layout

SMALL = {"layers": 2, "width": 16, "path_features": 12, "pdm_features": 8, "scalar_features": 4}


@pytest.mark.parametrize("name", PATH_EXTRACTORS)
@pytest.mark.parametrize(("waypoints", "gaussians"), [(64, 4), (1, 1), (7, 3)])
def test_every_path_extractor_serves_every_size(name, waypoints, gaussians):
    layout, settings = Layout(waypoints, gaussians), NetworkSettings(**SMALL, path_extractor=name)
    observation = torch.rand(5, layout.size)
    extractor = FeatureExtractor(settings, layout)
    assert extractor(observation).shape == (5, 12 + 8 + 3 * 4)
    mean, log_std = Actor(settings, layout)(observation)
    assert mean.shape == log_std.shape == (5,)
    assert Critics(settings, layout)(observation, torch.rand(5)).shape == (2, 5)


@pytest.mark.parametrize("name", PATH_EXTRACTORS)
def test_every_part_of_the_observation_counts(name):
    torch.manual_seed(0)
    layout, settings = Layout(16, 2), NetworkSettings(**SMALL, path_extractor=name)
    critics = Critics(settings, layout)
    observation = torch.rand(64, layout.size, requires_grad=True)
    action = torch.rand(64, requires_grad=True)
    critics(observation, action).sum().backward()
    assert bool((observation.grad.abs().amax(dim=0) > 0.0).all())
    assert bool((action.grad != 0.0).any())


def test_extractors_differ_as_they_should():
    """One layer; x and y as channels; x and y as rows with shared weights."""
    kinds = {
        name: [type(m).__name__ for m in PATH_EXTRACTORS[name](64, 10).modules()]
        for name in PATH_EXTRACTORS
    }
    assert kinds["fcn"].count("Linear") == 1
    assert "Conv1d" not in kinds["fcn"]
    assert kinds["cnn_1d"].count("Conv1d") == 3
    assert kinds["cnn_2d"].count("Conv2d") == 3


def test_the_papers_core_has_its_size():
    with torch.device("meta"):
        actor = Actor(NetworkSettings(), Layout(64, 4))
    sizes = [tuple(each.weight.shape) for each in actor.core if hasattr(each, "weight")]
    assert sizes == [(2000, 1000 + 128 + 3 * 16)] + [(2000, 2000)] * 7


def test_log_probability_is_that_of_the_squashed_gaussian():
    torch.manual_seed(1)
    actor = Actor(NetworkSettings(**SMALL), Layout(8, 2))
    observation = torch.rand(50, Layout(8, 2).size)
    action, log_probability = actor.sample(observation, torch.Generator().manual_seed(0))
    mean, log_std = actor(observation)
    action, mean, std = (x.detach().double().numpy() for x in (action, mean, log_std.exp()))
    # The density of the Gaussian there, over how much tanh stretches the ground.
    wanted = stats.norm(mean, std).logpdf(np.arctanh(action)) - np.log(1.0 - action**2)
    np.testing.assert_allclose(log_probability.detach().numpy(), wanted, atol=1e-3, rtol=1e-3)
    assert (np.abs(action) < 1.0).all()


@pytest.mark.parametrize("field", ["layers", "width", "path_features", "scalar_features"])
def test_wrong_sizes_are_refused(field):
    with pytest.raises(InvalidInput, match=f"^{field} must be at least 1"):
        NetworkSettings(**{field: 0})


def test_unknown_extractor_is_refused():
    with pytest.raises(InvalidInput, match="path_extractor must be one of fcn, cnn_1d, cnn_2d"):
        NetworkSettings(path_extractor="lstm")
