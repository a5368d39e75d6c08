"""Errors that are not as stated: how instruments of the twin err otherwise than logs and defaults say.

A twin whose processing knows its errors shows nothing of a survey, where nobody does. With
``twin.effects.misstated`` each quantity of `QUANTITIES` is the stated one times a factor of its own, drawn
from the seed with an even logarithm between a half and two. What the logs state, and what the defaults
presume, stays.
"""

from typing import Final

from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import TwinConfig

QUANTITIES: Final = {
    "level": ("ins", ("sigma_roll_deg", "sigma_pitch_deg")),
    "heading": ("ins", ("sigma_heading_deg",)),
    "attitude_time": ("ins", ("attitude_time_s",)),
    "ins_position": ("ins", ("sigma_position_m",)),
    "velocity": ("ins", ("sigma_velocity_mps",)),
    "gnss_position": ("gnss", ("sigma_m", "sigma_float_m", "sigma_single_m")),
    "position_time": ("gnss", ("correlation_time_s",)),
    "white_share": ("gnss", ("white_share",)),
    "weak_echo": ("lidar", ("sigma_weak_m",)),
    "divergence": ("lidar", ("divergence_mrad",)),
    "exposure_time": ("camera", ("jitter_s",)),
}
"""What is misstated: section of ``twin`` and settings that share a factor."""


def factors(config: TwinConfig, seed: int) -> dict[str, float]:
    """Factor on each of `QUANTITIES`; 1 where errors are as stated.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    """
    if not config.effects.misstated:
        return dict.fromkeys(QUANTITIES, 1.0)
    return {name: 2.0 ** float(generator(seed, f"misstated {name}").uniform(-1, 1)) for name in QUANTITIES}


def as_it_errs(config: TwinConfig, seed: int) -> TwinConfig:
    """The section ``twin`` with the sizes and times that errors truly have."""
    found = config
    for name, factor in factors(config, seed).items():
        if factor != 1.0:
            section, settings = QUANTITIES[name]
            part = getattr(found, section)
            true = {key: _times(getattr(part, key), factor) for key in settings}
            found = found.model_copy(update={section: part.model_copy(update=true)})
    return found


def _times(stated: float | tuple[float, ...], factor: float) -> float | tuple[float, ...]:
    return tuple(factor * each for each in stated) if isinstance(stated, tuple) else factor * stated
