"""The gallery: a picture of everything that is built, and a sheet of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from amslicer import cli, gallery
from amslicer.noise import NOISES


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gallery, "PIXELS", 60)
    monkeypatch.setattr(gallery, "SPECTRUM_PERIODS", 10.0)


@pytest.mark.parametrize("noise", NOISES)
def test_pictures_of_a_noise(noise: str) -> None:
    made = dict(gallery.pictures(noise))
    profiles = ["pwm, 30 %", "symmetric, three materials", "cyclic, three materials"]
    assert list(made) == ["value Re G", *profiles, "painted", "spectrum of pwm"]
    assert (made["cyclic, three materials"] is None) == (NOISES[noise].reads == "value")
    for name, picture in made.items():
        if picture is not None:
            assert picture.shape == (60, 60, 3), name
            assert len(np.unique(picture.reshape(-1, 3), axis=0)) >= 2, name
    pwm = made["pwm, 30 %"]
    assert pwm is not None
    blue = np.mean(np.all(pwm == (0x2B, 0x6C, 0xB0), axis=-1))
    assert blue == pytest.approx(0.3, abs=0.08)  # 100 periods² scatter by 0.02


def test_the_command_writes_a_sheet_and_every_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "pictures"
    assert cli.main(["gallery", "-o", str(out)]) == 0
    assert capsys.readouterr().out.strip() == str(out / "gallery.png")
    built = sum(6 if maker.reads == "phase" else 5 for maker in NOISES.values())
    assert len(list(out.glob("*.png"))) == built + 1
    with Image.open(out / "gallery.png") as sheet:
        assert sheet.width > 6 * 60
        assert sheet.height > len(NOISES) * 60


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert cli.main(["gallery", "-o", str(tmp_path / "file" / "pictures")]) == 6
