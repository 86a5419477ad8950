"""The paper's networks: five sub-extractors, then a fully connected core.

The paper shows the extractors in figures alone. Decided here: the small parts pass one fully
connected layer each; the convolutions have the kernels and strides of Mnih et al. (2015),
"Human-level control through deep reinforcement learning", along the waypoints, padded by half a
kernel, so that any number of waypoints will do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from wisar_planner.errors import InvalidInput
from wisar_planner.training import squashed_gaussian
from wisar_planner.training.config import check_at_least
from wisar_planner.training.paper.observation import Layout

# Limits of the logarithm of the standard deviation, those of Stable-Baselines3.
_LOG_STD_MIN, _LOG_STD_MAX = -20.0, 2.0

# Channels, kernel and stride of Mnih's convolutions.
_CONVOLUTIONS = ((32, 8, 4), (64, 4, 2), (64, 3, 1))


@dataclass(frozen=True)
class NetworkSettings:
    """Size of the networks; actor and critics have the same.

    Parameters
    ----------
    layers, width : int
        The core: fully connected layers and their width.
    path_extractor : str
        `fcn`, one fully connected layer; `cnn_1d`, convolutions over the waypoints with x and y as
        channels; `cnn_2d`, convolutions over the path as an image of 2 x N.
    path_features : int
        What the path's extractor returns.
    pdm_features : int
        What the map's extractor returns.
    scalar_features : int
        What each of those of position, out-of-bounds and steps returns.
    """

    layers: int = 8
    width: int = 2000
    path_extractor: str = "cnn_2d"
    path_features: int = 1000
    pdm_features: int = 128
    scalar_features: int = 16

    def __post_init__(self) -> None:
        check_at_least(self, layers=1, width=1, path_features=1, pdm_features=1, scalar_features=1)
        if self.path_extractor not in PATH_EXTRACTORS:
            raise InvalidInput(
                f"path_extractor must be one of {', '.join(PATH_EXTRACTORS)}, "
                f"not {self.path_extractor!r}"
            )


def _fcn(waypoints: int, features: int) -> nn.Module:
    return nn.Sequential(nn.Linear(2 * waypoints, features), nn.ReLU())


def _cnn_1d(waypoints: int, features: int) -> nn.Module:
    layers: list[nn.Module] = [nn.Unflatten(1, (2, waypoints))]
    channels, length = 2, waypoints
    for out, kernel, stride in _CONVOLUTIONS:
        layers += [nn.Conv1d(channels, out, kernel, stride, kernel // 2), nn.ReLU()]
        channels, length = out, (length + 2 * (kernel // 2) - kernel) // stride + 1
    return nn.Sequential(*layers, nn.Flatten(), nn.Linear(channels * length, features), nn.ReLU())


def _cnn_2d(waypoints: int, features: int) -> nn.Module:
    # The image keeps its two rows, so that x and y share weights; were they merged at once, this
    # would be the 1-D network. Of a kernel over two rows only three can meet more than padding.
    layers: list[nn.Module] = [nn.Unflatten(1, (1, 2, waypoints))]
    channels, length = 1, waypoints
    for out, kernel, stride in _CONVOLUTIONS:
        half = kernel // 2
        layers += [nn.Conv2d(channels, out, (3, kernel), (1, stride), (1, half)), nn.ReLU()]
        channels, length = out, (length + 2 * half - kernel) // stride + 1
    return nn.Sequential(
        *layers, nn.Flatten(), nn.Linear(2 * channels * length, features), nn.ReLU()
    )


#: Extractors of the path by name: made of the number of waypoints and of features.
PATH_EXTRACTORS: Mapping[str, Callable[[int, int], nn.Module]] = {
    "fcn": _fcn,
    "cnn_1d": _cnn_1d,
    "cnn_2d": _cnn_2d,
}


class FeatureExtractor(nn.Module):
    """The five sub-extractors side by side.

    Parameters
    ----------
    settings : NetworkSettings
        Sizes.
    layout : Layout
        Layout of the observation.
    """

    def __init__(self, settings: NetworkSettings, layout: Layout) -> None:
        super().__init__()
        self._layout = layout
        made = PATH_EXTRACTORS[settings.path_extractor]
        extractors = {"path": made(layout.waypoints, settings.path_features)}
        for name, size in layout.sizes.items():
            if name != "path":
                features = settings.pdm_features if name == "pdm" else settings.scalar_features
                extractors[name] = nn.Sequential(nn.Linear(size, features), nn.ReLU())
        self.parts = nn.ModuleDict(extractors)
        #: Features of all of them together.
        self.size = settings.path_features + settings.pdm_features + 3 * settings.scalar_features

    def forward(self, observation: Tensor) -> Tensor:
        """Return the features of observations, (B, size)."""
        parts = self._layout.split(observation)
        return torch.cat([self.parts[name](part) for name, part in parts.items()], dim=-1)


def _core(inputs: int, settings: NetworkSettings) -> nn.Sequential:
    layers: list[nn.Module] = []
    for layer in range(settings.layers):
        layers += [nn.Linear(settings.width if layer else inputs, settings.width), nn.ReLU()]
    return nn.Sequential(*layers)


class Actor(nn.Module):
    """A squashed Gaussian over the heading.

    Parameters
    ----------
    settings, layout
        See `FeatureExtractor`.
    """

    def __init__(self, settings: NetworkSettings, layout: Layout) -> None:
        super().__init__()
        self.extractor = FeatureExtractor(settings, layout)
        self.core = _core(self.extractor.size, settings)
        self.head = nn.Linear(settings.width, 2)

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and logarithm of the standard deviation before the squashing, (B,) each."""
        mean, log_std = self.head(self.core(self.extractor(observation))).unbind(dim=-1)
        return mean, log_std.clamp(_LOG_STD_MIN, _LOG_STD_MAX)

    def sample(self, observation: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return random actions and the logarithms of their probability densities, (B,) each."""
        mean, log_std = self(observation)
        return squashed_gaussian.sample(mean, log_std, mean.shape, generator)


class Critics(nn.Module):
    """Twin critics Q(s, a) on one extractor, as in Stable-Baselines3.

    Parameters
    ----------
    settings, layout
        See `FeatureExtractor`.
    """

    def __init__(self, settings: NetworkSettings, layout: Layout) -> None:
        super().__init__()
        self.extractor = FeatureExtractor(settings, layout)
        self.critics = nn.ModuleList(
            nn.Sequential(_core(self.extractor.size + 1, settings), nn.Linear(settings.width, 1))
            for _ in range(2)
        )

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """Return the values of actions, (2, B)."""
        inputs = torch.cat([self.extractor(observation), action[:, None]], dim=-1)
        return torch.stack([critic(inputs)[:, 0] for critic in self.critics])
