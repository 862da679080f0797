"""Deep graph convolutional network for point labels (DGCNN, Wang et al. 2019).

The layers are torch-geometric's ``EdgeConv`` with max aggregation. The graph is a setting of the
weights. "dynamic", as published: each layer after the first takes a point's neighbours anew, in the
space of its features. That is torch-geometric's ``DynamicEdgeConv``, whose own search needs a
compiled extra that no package index has; `nearest_features` stands in for it. "fixed", which the
shipped weights have: neighbours by coordinates, built outside (`cherrypicker.segmentation.spheres`)
at several scales (among all points, among a quarter, a sixteenth), which reach far as well.
"""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch
from torch import nn
from torch_geometric.nn import EdgeConv

from cherrypicker.classes import CHANNELS
from cherrypicker.errors import StageError

logger = logging.getLogger(__name__)

N_CLASSES = len(CHANNELS)
N_FEATURES = 10  # RGB, colour flag, global xyz, normalised xyz
CHECKPOINT_FORMAT = "cherrypicker-dgcnn-1"


def choose_device(threads: int, gpu: int) -> str:
    """Set the threads of torch and numba, and name the device: "cuda" or "cpu".

    Of the GPUs that the rule was given, 0 means the CPU even where one is there.
    """
    torch.set_num_threads(threads)
    most = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    numba.set_num_threads(min(threads, most))
    if gpu and not torch.cuda.is_available():
        logger.warning("a GPU was granted but torch finds none; computing on the CPU")
    return "cuda" if gpu and torch.cuda.is_available() else "cpu"


def neighbor_max(values: torch.Tensor, neighbors: torch.Tensor) -> torch.Tensor:
    """Channel-wise maximum over the neighbours, ``out[i, c] = max_q values[neighbors[i, q], c]``.

    Values (N, C) and indices (M, k) to (M, C). The gathered (M, k, C) tensor is never made.
    """
    columns = neighbors.T.contiguous()  # rows of one neighbour each are gathered three times faster
    with torch.no_grad():
        largest = values.index_select(0, columns[0])
        which = columns[0][:, None].expand_as(largest)
        for column in columns[1:]:
            other = values.index_select(0, column)
            if values.requires_grad:
                which = torch.where(other > largest, column[:, None], which)
            largest = torch.maximum(largest, other)
    return values.gather(0, which.long()) if values.requires_grad else largest


class LinearEdgeConv(EdgeConv):
    """``EdgeConv`` whose edge function is one linear layer, computed without the edges.

    With ``h(x_i, x_j - x_i) = A x_i + B (x_j - x_i) + b`` the maximum over the neighbours j is
    ``(A - B) x_i + b + max_j(B x_j)``: one product a point in place of one an edge. The result
    equals ``EdgeConv`` with the same weights (a test holds the two against each other); the
    non-linearity, monotone, follows the aggregation.
    """

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__(nn.Linear(2 * in_channels, out_channels), aggr="max")
        self.in_channels = in_channels

    def forward(self, x: torch.Tensor, neighbors: torch.Tensor) -> torch.Tensor:
        """Features (N, C_in) and neighbour indices (N, k) int to features (N, C_out)."""
        of_self, of_offset = self.nn.weight.split(self.in_channels, dim=1)
        center = torch.nn.functional.linear(x, of_self - of_offset, self.nn.bias)
        offset = torch.nn.functional.linear(x, of_offset)
        return center + neighbor_max(offset, neighbors)


def nearest_features(h: torch.Tensor, sizes: list[int], k: int) -> torch.Tensor:
    """Rows (N, k) of each point's neighbours in feature space, itself first, each sphere by itself.

    `h` (N, C) are the spheres' points one after another, `sizes` how many each has; in one of fewer
    than k a point is repeated.
    """
    found, start = [], 0
    with torch.no_grad():
        for part in h.split(sizes):
            apart = torch.cdist(part, part).fill_diagonal_(-1.0)  # itself first
            nearest = apart.topk(min(k, len(part)), largest=False).indices
            found.append(nearest[:, torch.arange(k).clamp(max=len(part) - 1)] + start)
            start += len(part)
    return torch.cat(found)


def _layer(n_in: int, n_out: int) -> list[nn.Module]:
    return [nn.Linear(n_in, n_out), nn.BatchNorm1d(n_out), nn.LeakyReLU(0.1)]


class _Block(nn.Module):
    """EdgeConv, a layer per point, and a skip connection."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv = LinearEdgeConv(width + 3, width)
        self.conv_norm = nn.BatchNorm1d(width)
        self.point = nn.Linear(width, width)
        self.point_norm = nn.BatchNorm1d(width)

    def forward(
        self, h: torch.Tensor, positions: torch.Tensor, neighbors: torch.Tensor
    ) -> torch.Tensor:
        # The coordinates enter every layer, so that each scale sees true offsets.
        edge = self.conv(torch.cat([h, positions], dim=1), neighbors)
        edge = nn.functional.leaky_relu(self.conv_norm(edge), 0.1)
        return nn.functional.leaky_relu(h + self.point_norm(self.point(edge)), 0.1)


class Dgcnn(nn.Module):
    """Point labels from spherical samples.

    The EdgeConv layers have ``width`` channels, the descriptor of a sphere, a maximum over its
    points, has ``embedding``. By its scale each layer uses a graph of all points (0), a quarter of
    them (1) or a sixteenth (2), with ``k`` neighbours a point. In a "fixed" graph these are
    neighbours by coordinates in every layer; in a "dynamic" one they are by coordinates in the
    first, by the features in those after it, and all points are at one scale.
    """

    def __init__(
        self,
        width: int = 64,
        embedding: int = 192,
        scales: Sequence[int] = (0, 0, 1, 2),
        k: int = 12,
        graph: str = "fixed",
    ) -> None:
        super().__init__()
        if graph not in ("fixed", "dynamic"):
            raise ValueError(f"unknown graph {graph!r} (known: fixed, dynamic)")
        scales = [0] * len(scales) if graph == "dynamic" else list(scales)
        self.settings: dict[str, Any] = {"width": width, "embedding": embedding, "scales": scales}
        self.settings |= {"k": k, "graph": graph}
        self.stem = nn.Sequential(*_layer(N_FEATURES, width))
        self.blocks = nn.ModuleList(_Block(width) for _ in scales)
        # The head sees the features after the last layer of each level: a scale, or every layer
        self._levels = range(len(scales)) if graph == "dynamic" else scales
        joined = width * len(set(self._levels))
        self.embed = nn.Sequential(*_layer(joined, embedding))
        hidden = 2 * width
        self.head_point = nn.Linear(joined, hidden)
        self.head_sphere = nn.Linear(embedding, hidden, bias=False)
        self.head = nn.Sequential(
            nn.BatchNorm1d(hidden),  # of the sum of the two above
            nn.LeakyReLU(0.1),
            *_layer(hidden, width),
            nn.Linear(width, N_CLASSES),
        )

    def forward(
        self, features: torch.Tensor, graphs: list[torch.Tensor], sizes: list[int]
    ) -> torch.Tensor:
        """Log-probabilities (N, N_CLASSES) of a batch of spheres, as `collate` joins them.

        Of the features (N, 10) the last three columns are the normalised xyz.
        """
        positions = features[:, -3:]
        h = self.stem(features)
        levels: dict[int, torch.Tensor] = {}
        for level, block, scale in zip(self._levels, self.blocks, self.settings["scales"]):
            neighbors = graphs[scale]
            if levels and self.settings["graph"] == "dynamic":
                neighbors = nearest_features(h, sizes, self.settings["k"])
            levels[level] = h = block(h, positions, neighbors)
        joined = torch.cat(list(levels.values()), dim=1)
        embedded = self.embed(joined)
        sphere = torch.stack([part.amax(dim=0) for part in embedded.split(sizes)])
        context = self.head_sphere(sphere)
        repeats = torch.tensor(sizes, device=features.device)
        logits = self.head(self.head_point(joined) + context.repeat_interleave(repeats, dim=0))
        return nn.functional.log_softmax(logits, dim=1)


def collate(spheres: list) -> tuple[torch.Tensor, list[torch.Tensor], list[int]]:
    """Join spheres, features (n, 10) float32 and neighbours (n, k) int32 a scale, into one batch.

    Their points' features (N, 10) one after another, neighbours (N, k) among all N rows, a tensor
    a scale, and the number of points of each sphere.
    """
    features, graphs = zip(*spheres)
    sizes = [len(each) for each in features]
    starts = np.cumsum([0, *sizes[:-1]], dtype=np.int32)
    joined = [
        np.concatenate([g + start for g, start in zip(each, starts)]) for each in zip(*graphs)
    ]
    return torch.from_numpy(np.concatenate(features)), list(map(torch.from_numpy, joined)), sizes


def load_weights(path: str | Path) -> tuple[Dgcnn, dict[str, Any]]:
    """Read a network, in evaluation mode on the CPU, and how it was trained to see a cloud.

    The file is one of `cherrypicker_lab.training.segmentation.weights.save_weights`.

    Raises
    ------
    StageError
        The file is missing, unreadable, or not one of ours.
    """
    where: dict[str, Any] = {"file": path, "key": "segment.weights"}
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises several unrelated types on a damaged file
        cause = f"the segmentation weights cannot be read ({type(error).__name__})"
        raise StageError(cause, **where) from error
    if not isinstance(content, dict) or content.get("format") != CHECKPOINT_FORMAT:
        raise StageError("not a file of segmentation weights", **where)
    try:
        settings = dict(content["settings"])
        settings.pop("n_classes", None)  # older files tell; the tensors show it
        with torch.device("meta"):  # takes no memory for sizes that the file's tensors do not have
            network = Dgcnn(**settings)
        network.load_state_dict(content["state"], assign=True)
        sampling = dict(content["sampling"])
    except (LookupError, ValueError, TypeError, AttributeError, RuntimeError) as error:
        cause = f"the segmentation weights do not fit the network of {N_CLASSES} classes"
        raise StageError(cause, **where) from error
    return network.eval(), sampling
