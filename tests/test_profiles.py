"""Waveforms as profiles: their ranks, on the device and in NumPy, whole jobs, and what verification knows of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import parts
import pytest
from numpy.typing import NDArray
from scipy.special import ndtri
from test_kernels import device_labels, random_phasors

import amslicer
from amslicer import reference
from amslicer.device import Device
from amslicer.noise import NOISES, Noise
from amslicer.pipeline import prepare
from amslicer.profiles import PROFILES, SHAPES, Profile, make_profile
from amslicer.profiles.rank import BLENDS, SAMPLES, RankProfile, rank_profile, turn_of
from amslicer.profiles.waveforms import WAVES

Floats = NDArray[np.float64]
# Without plateaus, so that a share of a turn says all; the last three are not the same both ways.
SMOOTH: dict[str, Any] = {
    "sine": "sine",
    "triangle": "triangle",
    "two humps": {"harmonics": [1, 1]},
    "sines": {"harmonics": [{"amplitude": 1, "phase": -90}]},
    "table of five": {"table": [0, 1, 0.4, 0.3, 0.9]},
    "sawtooth": "sawtooth",
    "table of three": {"table": [0, 1, 0.3]},
    "bent": {"harmonics": [1, {"amplitude": 0.5, "phase": 40}]},
}
ARROWS = {"table of five", "sawtooth", "table of three", "bent"}
ABC = ("a", "b", "c")
SHARES = {"a": 0.3, "b": 0.2, "c": "rest"}
EVEN_TABLE = {"table": [0, 1, 0.6, 0.6, 1]}


def shape(content: Any) -> Any:
    """A validated profile."""
    return content if isinstance(content, str) else SHAPES[next(iter(content))].model_validate(content)


def ranked(content: Any) -> RankProfile:
    made = shape(content)
    return rank_profile((WAVES[made],)) if isinstance(made, str) else rank_profile(made.waves(), made.axes())


def phase_noise() -> Noise:
    return parts.noise("phasor")


def ranks_over_a_turn(profile: RankProfile) -> tuple[Floats, NDArray[np.float32]]:
    """Shares of a turn and the ranks that the device finds there, of the first waveform."""
    turn = turn_of((np.arange(SAMPLES) + 0.5) / SAMPLES * 4)
    return turn, profile.rank_table(phase_noise()).ranks[0]


@pytest.mark.parametrize("name", list(WAVES))
def test_named_waveforms_are_the_profiles_of_that_name(name: str) -> None:
    """Sine, triangle and square have the same above a level as pwm; a sawtooth falls through a turn, as cyclic does."""
    profile = ranked(name)
    turn, rank = ranks_over_a_turn(profile)
    expected = turn if PROFILES[name].arrows else 2 * np.minimum(turn, 1 - turn)
    assert profile.arrows == PROFILES[name].arrows
    np.testing.assert_allclose(rank, expected, atol=1e-3 / 4)


@pytest.mark.parametrize("name", list(SMOOTH))
def test_a_waveform_that_can_be_turned_to_be_even_needs_no_arrow(name: str) -> None:
    assert ranked(SMOOTH[name]).arrows == (name in ARROWS)


@pytest.mark.parametrize("name", list(SMOOTH))
def test_ranks_are_shares_of_a_turn(name: str) -> None:
    """Where the rank is below c, f is above all that it is elsewhere, and that is c of the turn."""
    profile = ranked(SMOOTH[name])
    turn, rank = ranks_over_a_turn(profile)
    cell = np.diff(np.unwrap(turn_of(np.linspace(0, 4, SAMPLES + 1)), period=1))
    height = profile.waves[0](turn)
    for c in (0.1, 0.35, 0.8):
        below = rank < c
        assert cell[below].sum() == pytest.approx(c, abs=1e-3)
        assert height[below].min() >= height[~below].max() - 1e-2


def test_plateaus_fill_up_from_their_middle() -> None:
    turn, rank = ranks_over_a_turn(ranked({"table": [0, 0, 1, 1, 0, 0]}))  # high from 2/6 to 3/6, turned to lie about 0
    first = np.minimum(turn, 1 - turn)[rank < 0.1]
    assert first.max() == pytest.approx(0.05, abs=1e-3)
    last = np.minimum(turn, 1 - turn)[rank > 0.9]
    assert last.min() == pytest.approx(0.45, abs=1e-3)


def test_a_blend_goes_from_one_profile_to_the_other_and_keeps_ratios_between() -> None:
    blend = ranked({"blend": {"from": "sine", "to": {"harmonics": [0, 1]}, "by": 0.5}})
    table = blend.rank_table(phase_noise()).ranks
    assert len(table) == BLENDS
    assert np.array_equal(table[0], ranked("sine").rank_table(phase_noise()).ranks[0])
    assert np.array_equal(table[-1], ranked({"harmonics": [0, 1]}).rank_table(phase_noise()).ranks[0])
    cell = np.diff(np.unwrap(turn_of(np.linspace(0, 4, SAMPLES + 1)), period=1))
    shares = [cell[row < 0.3].sum() for row in table]
    np.testing.assert_allclose(shares, 0.3, atol=1e-3)


@pytest.mark.parametrize("cumulative", [[0.25], [0.2, 0.7], [0.0, 0.3, 0.3, 1.0]], ids=str)
@pytest.mark.parametrize("name", list(SMOOTH))
def test_device(device: Device, name: str, cumulative: list[float]) -> None:
    profile = ranked(SMOOTH[name])
    g = random_phasors((2, 64, 96), 5)
    g[0, :3, :3] = 0
    ratios = np.array(cumulative)[:, None, None]
    got = device_labels(device, g, ratios, np.ones(g.shape, np.uint8), profile=profile)
    expected = reference.waveform_labels(g, ratios[:, None], profile.waves[0])
    # The nearest of 8192 entries: an edge moves by up to 1/12868 of a turn, on average half; a level has up to four.
    off = got[g != 0] != expected[g != 0]
    print(f"{name}: {np.mean(off):.5f} of the pixels differ")
    assert np.mean(off) <= 4 * len(cumulative) / 16384 + 3e-4
    fills = np.array([0.0, 1.0])[:, None, None]
    assert np.all(device_labels(device, g, fills, np.ones(g.shape, np.uint8), profile=profile) == 2)


def test_conjugate_fields_look_the_same_to_even_profiles(device: Device) -> None:
    """Tiles may take the other sign (amslicer/tiles.py)."""
    g = random_phasors((1, 64, 64), 6)
    for name in SMOOTH:
        profile, solid = ranked(SMOOTH[name]), np.ones(g.shape, np.uint8)
        ratios = np.array([0.2, 0.6])[:, None, None]
        one, other = (device_labels(device, some, ratios, solid, profile=profile) for some in (g, g.conj()))
        differ = np.mean(one != other)
        assert differ > 0.05 if name in ARROWS else differ == 0


# Others have no waves whose form a profile could be, or are wave noise with another spectrum.
WAVING = [name for name in NOISES if name == "wave" or parts.noise(name).made_of == "kernels"]


@pytest.mark.parametrize("noise", WAVING)
@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize(
    "profile", [EVEN_TABLE, {"harmonics": [1, 0, 0.4]},
                {"blend": {"from": "pwm", "to": EVEN_TABLE, "by": {"gradient": {"axis": "x", "from": 0, "to": 1}}}}],
    ids=["table", "harmonics", "blend"],
)  # fmt: skip
def test_jobs_have_their_ratios_and_are_verified(tmp_path: Path, noise: str, dimensions: int, profile: Any) -> None:
    part = parts.box(tmp_path, (36, 30, 0.3) if dimensions == 2 else (16, 12, 6))
    job = parts.job(
        part, materials=ABC, ratio=SHARES, orientation=30, noise=noise, profile=profile, dimensions=dimensions
    )
    amslicer.slice_job(job, tmp_path / "out")
    report = amslicer.verify(tmp_path / "out")
    assert report.ok, [c for c in report.checks if not c.ok]
    if dimensions == 2 and parts.noise(noise).reads == "phase":  # 1080 periods²; values scatter several times as far
        assert max(abs(m.error) for m in report.materials.values()) < 0.005


def test_a_blend_by_height_changes_from_layer_to_layer(tmp_path: Path) -> None:
    part = parts.box(tmp_path, (12, 12, 1.66))  # 20 layers
    by = {"gradient": {"axis": "z", "from": 0, "to": 1, "start": 0, "end": 1.6}}
    job = parts.job(part, profile={"blend": {"from": "sine", "to": {"harmonics": [0, 1]}, "by": by}}, ratio=0.3)
    layers = parts.labels(job)
    ends = [parts.bitmap(parts.job(part, profile=p, ratio=0.3)) for p in ("sine", {"harmonics": [0, 1]})]
    assert np.mean(layers[0] != ends[0]) < 0.001
    assert np.mean(layers[-1] != ends[1]) < 0.001
    assert np.mean(layers[3 * len(layers) // 4] != ends[0]) > 0.05
    assert np.array_equal(parts.labels(job, 7, 9), layers[7:9])


def test_two_humps_make_twice_as_many_sheets(tmp_path: Path) -> None:
    job = parts.job(parts.plate(tmp_path, 40, 20), profile={"harmonics": [0, 1]}, ratio=0.5, bandwidth=0.1)
    plain = parts.job(parts.plate(tmp_path, 40, 20), ratio=0.5, bandwidth=0.1)
    edges = [np.count_nonzero(np.diff(parts.bitmap(j).astype(int), axis=1)) for j in (job, plain)]
    assert edges[0] / edges[1] == pytest.approx(2, rel=0.03)


@pytest.mark.parametrize(
    ("profile", "said"),
    [
        ({"table": [2, 2]}, "all 2 values are 2: none is above another"),
        ({"table": [1]}, r"pattern\.profile\.table: .* at least 2"),
        ({"harmonics": [0, 0]}, "all amplitudes are 0"),
        ({"square": 1}, r"pattern\.profile\.square: .*less than 1.* but it is 1"),
        ({"pulse": 1}, r"pattern\.profile: .*pulse.* is no profile; one is pwm, symmetric"),
        ("pulse", r"pattern\.profile: .*pulse"),
        ({"blend": {"from": "sine", "to": "sawtooth"}}, r"pattern\.profile\.blend\.by' is missing"),
        ({"blend": {"from": "sine", "to": {"blend": {}}, "by": 0}}, "is no waveform"),
        ({"table": [0, 1], "square": 0.5}, "is no profile"),
        ({"square": 0.3, "duty": 1}, r"unknown key 'pattern\.profile\.duty'"),
        ({"table": [0, 1e7]}, r"pattern\.profile\.table\.1: .*less than or equal to 1000000"),
        ({"harmonics": [1, {"amplitude": 1, "fase": 2}]}, r"unknown key 'pattern\.profile\.harmonics\.1\.fase'"),
    ],
)  # fmt: skip
def test_wrong_profiles_are_refused(tmp_path: Path, profile: Any, said: str) -> None:
    with pytest.raises(amslicer.JobError, match=said):
        parts.job(parts.plate(tmp_path, 5, 5), profile=profile)


def test_a_blend_outside_0_to_1_is_refused_with_its_place(tmp_path: Path) -> None:
    by = {"gradient": {"axis": "x", "from": 0, "to": 1.5}}
    job = parts.job(parts.plate(tmp_path, 9, 5), profile={"blend": {"from": "sine", "to": EVEN_TABLE, "by": by}})
    with pytest.raises(amslicer.JobError, match=r"pattern\.profile\.blend\.by is 1\.\d+ at x = [6-9]\.\d+"):
        amslicer.slice_job(job, tmp_path / "out")


def test_waveforms_with_a_direction_need_arrows(tmp_path: Path) -> None:
    part = parts.plate(tmp_path, 20, 20)
    around = {"expression": "atan2(y - 10, x - 10)*90/pi"}  # half a turn around the middle: n becomes -n
    prepare(parts.job(part, orientation=around, profile=EVEN_TABLE))
    with pytest.raises(amslicer.JobError, match=r"pattern\.profile: this table needs arrows"):
        prepare(parts.job(part, orientation=around, profile={"table": [0, 1, 0.3]}))
    with pytest.raises(amslicer.JobError, match="this table needs a phase, but gabor"):
        parts.job(part, noise="gabor", profile={"table": [0, 1, 0.3]})


@pytest.mark.parametrize("name", list(SMOOTH))
def test_amplitudes_are_those_of_the_indicator(name: str) -> None:
    profile: Profile = ranked(SMOOTH[name])
    turn = (np.arange(100_000) + 0.5) / 100_000
    for low, high in ((0.0, 0.25), (0.2, 0.7), (0.7, 1.0)):
        label = reference.waveform_labels(np.exp(2j * np.pi * turn), [[low], [high]], profile.waves[0])  # type: ignore[attr-defined]
        inside = label == 2
        measured = [2 * abs(np.mean(inside * np.exp(2j * np.pi * h * turn))) for h in range(1, 13)]
        np.testing.assert_allclose(profile.amplitudes(low, high, 12), measured, atol=2e-3)


def test_growth_over_values_is_that_over_a_materials_parts_of_them() -> None:
    """Of two humps on half a turn, the highest tenth of values is the first and the last twentieth of them."""
    profile = ranked({"harmonics": [0, 1]})
    grown = profile.over_values(lambda c: np.stack([c, c**2], axis=-1), 0.0, 0.1)
    assert grown.shape == (1, 2)
    np.testing.assert_allclose(grown[0], [0.1, 0.05**2 + 1 - 0.95**2], atol=1e-3)


def test_values_are_looked_up_by_the_share_of_values_above_them() -> None:
    noise = parts.noise("gabor")
    table = ranked("triangle").rank_table(noise)
    value = (np.arange(SAMPLES) + 0.5) / SAMPLES * 2 * table.reach - table.reach
    for c in (0.05, 0.3, 0.5, 0.9):
        above = table.ranks[0] < c
        assert value[above].min() == pytest.approx(float(noise.levels_of(np.array(c))), abs=2 * table.reach / SAMPLES)
    assert table.reach == pytest.approx(6 * float(noise.levels_of(np.array(0.1587))), rel=1e-3)
    assert -ndtri(0.1587) == pytest.approx(1, abs=1e-3)


def test_profiles_are_known_by_name_or_by_shape() -> None:
    assert make_profile("pwm") is PROFILES["pwm"]
    assert isinstance(make_profile(shape(EVEN_TABLE)), RankProfile)


def turn_measure() -> Floats:
    """Shares of a turn of the entries of a table."""
    return np.diff(np.unwrap(turn_of(np.linspace(0, 4, SAMPLES + 1)), period=1))


TIED: dict[str, Any] = {
    "a wave and its opposite": {"blend": {"from": "sine", "to": {"harmonics": [-1]}, "by": 0.5}},
    "triangle and table": {"blend": {"from": "pwm", "to": {"table": [-1, 1]}, "by": 0.5}},
    "a thin square": {"square": 0.02},
    "fine plateaus": {"table": ([1] * 8 + [0] * 8) * 16},
    "small values": {"table": [0, 1e-10, 0.6e-10, 0.6e-10, 1e-10]},
    "far from 0": {"table": [1e5, 1e5 + 3, 1e5 + 1]},
    "two humps": {"harmonics": [0, 1]},
}


@pytest.mark.parametrize("name", list(TIED))
def test_ratios_hold_where_values_tie(name: str) -> None:
    """All levels of blends; a table's step is 1/6434 of a turn at most, and mirror images go together."""
    for row in ranked(TIED[name]).rank_table(phase_noise()).ranks:
        for c in (0.02, 0.22, 0.3, 0.7, 0.985):
            assert turn_measure()[row < c].sum() == pytest.approx(c, abs=4 / 6434)


@pytest.mark.parametrize(
    "table", [[0, 0, 3, 1, 3], [0] * 40 + [1] * 20 + [0] * 40, np.exp(-(((np.arange(360) - 77) / 15) ** 2)).tolist(),
              [*range(50), *range(49, -1, -1)]], ids=["five", "box", "bump", "ramps"],
)  # fmt: skip
def test_symmetric_tables_need_no_arrow_and_others_do(table: list[float]) -> None:
    assert not ranked({"table": table}).arrows
    assert ranked({"table": [*table, max(table) + 1, min(table), min(table)]}).arrows
    assert ranked({"table": [v + 1e5 for v in [0, 3, 1]]}).arrows


def test_harmonics_of_one_rounded_phase_are_even() -> None:
    turned = [{"amplitude": a, "phase": round(h * 33.3333, 3)} for h, a in enumerate((0.3, 1, 0.5), 1)]
    assert not ranked({"harmonics": turned}).arrows


def test_verification_says_where_it_sees_no_sheets_of_that_period(tmp_path: Path) -> None:
    job = parts.job(parts.plate(tmp_path, 40, 40), profile={"harmonics": [0, 1]}, ratio=0.5, orientation=30)
    amslicer.slice_job(job, tmp_path / "out")
    report = amslicer.verify(tmp_path / "out")
    assert [c.name.split(":")[0] for c in report.checks if not c.made] == ["direction", "period", "isotropy"]
    plain = parts.job(parts.plate(tmp_path, 40, 40), ratio=0.5, orientation=30)
    amslicer.slice_job(plain, tmp_path / "plain")
    assert all(c.made for c in amslicer.verify(tmp_path / "plain").checks)


@pytest.mark.parametrize(
    ("profile", "humps"),
    [("pwm", 1), ("cyclic", 1), ({"harmonics": [0, 1]}, 2), ({"harmonics": [0, 0, 1]}, 3), ({"square": 0.2}, 1),
     ({"table": [0, 1, 0.5, 0.5, 1]}, 2), ({"blend": {"from": "sine", "to": {"harmonics": [0, 1]}, "by": 0.5}}, 2)],
    ids=str,
)  # fmt: skip
def test_sheets_to_a_period(profile: Any, humps: int) -> None:
    assert make_profile(shape(profile)).humps == humps


def test_thin_sheets_of_a_waveform_are_noted(tmp_path: Path) -> None:
    printer = {"pitch_um": 40, "layer_um": 40, "smallest_feature_um": 200}
    settings: dict[str, Any] = {"period": 0.5, "ratio": 0.5, "printer": printer}
    for profile, noted in (("pwm", False), ({"harmonics": [0, 1]}, True)):
        job = parts.job(parts.plate(tmp_path, 10, 10), profile=profile, **settings)
        assert any("thinnest sheets are 125 µm" in note for note in prepare(job).notes()) == noted
