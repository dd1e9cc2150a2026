"""Profiles: from phase to material, apart from the noise that makes the phase.

`PROFILES` are those that a job names, `SHAPES` (waveforms.py) those with parameters. A waveform becomes material by the
rank of its values: so sine, triangle and square are all pwm – what they have above a level is the same – and sawtooth
is cyclic. They differ where they are blended.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from amslicer.profiles.key import CYCLIC, SYMMETRIC
from amslicer.profiles.profile import ROUNDING, Profile, RankTable
from amslicer.profiles.rank import rank_profile
from amslicer.profiles.waveforms import SHAPES, ProfileSpec, Shape

if TYPE_CHECKING:
    from amslicer.profiles.key import KeyProfile

# pwm is the two-material name of symmetric.
PROFILES: dict[str, KeyProfile] = {
    "pwm": SYMMETRIC,
    "symmetric": SYMMETRIC,
    "cyclic": CYCLIC,
    "sine": SYMMETRIC,
    "triangle": SYMMETRIC,
    "square": SYMMETRIC,
    "sawtooth": CYCLIC,
}


def make_profile(spec: str | Shape) -> Profile:
    """The profile that a job asks for."""
    return PROFILES[spec] if isinstance(spec, str) else rank_profile(spec.waves(), spec.axes())


def profile_name(spec: str | Shape) -> str:
    """What messages call it."""
    return spec if isinstance(spec, str) else f"this {next(iter(type(spec).model_fields))}"


__all__ = [
    "PROFILES",
    "ROUNDING",
    "SHAPES",
    "Profile",
    "ProfileSpec",
    "RankTable",
    "Shape",
    "make_profile",
    "profile_name",
]
