"""A compact U-Net that tells sky from everything else.

The paper uses a U-Net [1]_ (section Denoising). This one keeps the architecture (contracting path,
bottleneck, expanding path with skip connections) with few channels, so that a photo takes well
under a second on two cores and the weights fit into the repository.

References
----------
.. [1] Ronneberger, Fischer, Brox, "U-Net: Convolutional Networks for Biomedical Image
   Segmentation", MICCAI 2015.
"""

import os

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from cherrypicker.errors import StageError
from cherrypicker.files import read_npz

MEAN, STD = 0.45, 0.27  # of the photos it learns from, shares of white


def _block(n_in: int, n_out: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for n in (n_in, n_out):
        layers += [nn.Conv2d(n, n_out, 3, padding=1, bias=False), nn.BatchNorm2d(n_out)]
        layers += [nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)


class SkyUNet(nn.Module):
    """U-Net with one logit per pixel (positive: sky).

    The widths are channels per level, from full resolution down; each level halves the resolution.
    """

    def __init__(self, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.widths = tuple(int(w) for w in widths)
        self.down = nn.ModuleList(
            _block(n_in, n_out) for n_in, n_out in zip((3, *self.widths[:-1]), self.widths)
        )
        self.up = nn.ModuleList(
            _block(below + here, here) for below, here in zip(self.widths[1:], self.widths[:-1])
        )
        self.head = nn.Conv2d(self.widths[0], 1, 1)

    @property
    def stride(self) -> int:
        """Levels align exactly where height and width are multiples of this many pixels."""
        return 2 ** (len(self.widths) - 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return logits of shape (B, 1, H, W) for normalised images of shape (B, 3, H, W)."""
        skips = []
        for level, block in enumerate(self.down):
            x = block(F.max_pool2d(x, 2) if level else x)
            skips.append(x)
        x = skips.pop()
        for block in reversed(self.up):
            skip = skips.pop()
            x = F.interpolate(x, size=skip.shape[-2:], mode="nearest")
            x = block(torch.cat([x, skip], dim=1))
        return self.head(x)


def to_tensor(images: np.ndarray) -> torch.Tensor:
    """Normalise RGB images of shape (B, H, W, 3), uint8, to the network's (B, 3, H, W) float32."""
    x = torch.from_numpy(np.ascontiguousarray(images)).permute(0, 3, 1, 2).float() / 255.0
    return (x - MEAN) / STD


def load_weights(path: str | os.PathLike) -> SkyUNet:
    """Read a network as the laboratory writes it, NPZ of half precision, in evaluation mode.

    Raises
    ------
    StageError
        When the file is missing or does not hold such a network.
    """
    try:
        data = read_npz(path, required=("widths",))
        state = {k[2:]: torch.from_numpy(v) for k, v in data.items() if k.startswith("p:")}
        state = {k: v.float() if v.is_floating_point() else v for k, v in state.items()}
        with torch.device("meta"):  # takes no memory for widths that the file's arrays do not have
            net = SkyUNet(tuple(data["widths"].tolist()))
        net.load_state_dict(state, assign=True)
    except StageError as error:
        raise StageError(error.cause, file=path, key="sky.weights") from error
    except (LookupError, ValueError, TypeError, RuntimeError) as error:
        raise StageError(
            f"cannot read the sky network's weights: {error}", file=path, key="sky.weights"
        ) from error
    return net.eval()
