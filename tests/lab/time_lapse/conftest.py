"""Eight seconds of the tiny twin with a camera that looks at the right bank."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.lab.conftest import FRAME
from thalweg_lab.river import Scene, build_scene
from thalweg_lab.settings import TwinConfig, TwinTimeLapse
from thalweg_lab.time_lapse.record import TimeLapse

SEED = 11
MOUNTS: dict[str, Any] = {
    "camera": {"omega_deg": -89.6, "phi_deg": 0.3, "kappa_deg": 179.5, "lever_ics_m": [-0.25, 0.10, -0.18]}
}
CONFIG = TwinConfig.of_size("tiny")


def settings(**changes: Any) -> TwinTimeLapse:
    """480 by 360 pixels, two images a second, the first third of the voyage, five targets."""
    base: dict[str, Any] = {"size_px": (480, 360), "rate_hz": 2.0, "share": 0.32, "n_targets": 5}
    return TwinTimeLapse(**{**base, **changes})


@dataclass(frozen=True)
class Reach:
    """The scene, in memory and as a file, and the images of the usual settings."""

    scene: Scene
    path: Path
    recording: TimeLapse

    def other(self, **changes: Any) -> TimeLapse:
        """Images of other settings."""
        return TimeLapse.of(CONFIG, settings(**changes), SEED, FRAME, self.scene, MOUNTS)


@pytest.fixture(scope="session")
def reach(tmp_path_factory):
    path = tmp_path_factory.mktemp("reach") / "scene.npz"
    build_scene(CONFIG, SEED).write(path)
    # Written and read: coordinates are kept in float32, as for the images of a campaign.
    scene = Scene.read(path)
    return Reach(scene, path, TimeLapse.of(CONFIG, settings(), SEED, FRAME, scene, MOUNTS))
