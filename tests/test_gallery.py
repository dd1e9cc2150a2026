"""The gallery: a picture of everything that is built, and a sheet of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from amslicer import cli, figures, gallery


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gallery, "PIXELS", 60)
    monkeypatch.setattr(gallery, "SPECTRUM_PERIODS", 10.0)


@pytest.mark.parametrize("noise", gallery.ROWS)
def test_pictures_of_a_noise(noise: str) -> None:
    made = dict(gallery.pictures(noise))
    profiles = ["pwm, 30 %", "symmetric, three materials", "cyclic, three materials"]
    waveforms = ["harmonics, 40 %", "sine to harmonics"]
    assert list(made) == ["value Re G", *profiles, "painted", *waveforms, "spectrum of pwm"]
    assert (made["cyclic, three materials"] is None) == (gallery._made(noise).reads != "phase")
    for name, picture in made.items():
        if picture is not None:
            assert picture.shape == (60, 60, 3), name
            assert len(np.unique(picture.reshape(-1, 3), axis=0)) >= 2, name
    pwm = made["pwm, 30 %"]
    assert pwm is not None
    blue = np.mean(np.all(pwm == (0x2B, 0x6C, 0xB0), axis=-1))
    rough = noise.startswith(("wave-", "wave, "))  # cells and broad spectra scatter several times as far
    assert blue == pytest.approx(0.3, abs=0.25 if rough else 0.08)  # 100 periods² scatter by 0.02


def test_the_command_writes_a_sheet_and_every_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "pictures"
    assert cli.main(["gallery", "-o", str(out)]) == 0
    assert capsys.readouterr().out.split() == [str(out / "gallery.png"), str(out / "figures.png")]
    built = sum(picture is not None for row in gallery.ROWS for _, picture in gallery.pictures(row))
    assert len(list(out.glob("*.png"))) == built + 2
    with Image.open(out / "gallery.png") as sheet:
        assert sheet.width > 6 * 60
        assert sheet.height > len(gallery.ROWS) * 60


def middle(picture: NDArray[np.uint8]) -> float:
    """Mean grey of the middle of a spectrum, as a share of the brightest such square."""
    grey = picture[..., 0].astype(float)
    n = len(grey) // 12
    squares = np.lib.stride_tricks.sliding_window_view(grey, (n, n))[::2, ::2].mean(axis=(2, 3))
    return float(grey[len(grey) // 2 - n // 2 :, len(grey) // 2 - n // 2 :][:n, :n].mean() / squares.max())


def test_the_papers_figures_show_what_the_papers_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gallery, "PIXELS", 120)
    monkeypatch.setattr(gallery, "SPECTRUM_PERIODS", 24.0)
    figures._field.cache_clear()
    rows: dict[str, Any] = dict(figures.figures())
    figures._field.cache_clear()
    assert list(rows) == list(figures.ROWS)
    for row in rows.values():
        for name, picture in row:
            assert picture.shape == (120, 120, 3), name
            assert len(np.unique(picture)) > 1, name
    fig4 = [picture for _, picture in rows["phasor Fig. 4"]]
    assert middle(fig4[1]) > 0.5  # Gabor noise's variance has a central lobe
    assert middle(fig4[3]) < 0.2
    fig7 = dict(rows["phasor Figs 7 and 9"])
    assert middle(fig7["of Re G"]) > 0.5
    assert middle(dict(rows["phasor Figs 7 and 9"][:2])["spectrum of variance"]) < 0.2
    shares = [float(caption.split(": ")[1].split()[0]) for caption, _ in rows["phasor Fig. 16"]]
    assert shares[0] == pytest.approx(25, abs=0.7)  # 576 periods²
    errors = [float(c.split(": ")[1].split()[0]) for c, _ in rows["Gabor Fig. 10"] if c.startswith("error")]
    assert errors == pytest.approx([25, 1], rel=0.15)


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert cli.main(["gallery", "-o", str(tmp_path / "file" / "pictures")]) == 6
