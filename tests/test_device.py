"""Devices are believed when a child process has seen them work, and not before."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from amslicer import DeviceError, UsageError, cache, device
from amslicer.device import Device, DeviceInfo, choose_device, list_devices

BROKEN = DeviceInfo(0, 0, "Old Platform", "lists but cannot compile", "1.0", "cpu", 8, "unknown target CPU 'generic'")
CPU = DeviceInfo(1, 0, "Platform", "a processor", "3.1", "cpu", 2, "ok")
GPU = DeviceInfo(2, 0, "Other", "a graphics card", "3.0", "gpu", 64, "ok")


def pretend(monkeypatch: pytest.MonkeyPatch, *devices: DeviceInfo) -> None:
    monkeypatch.setattr(device, "_known_devices", lambda: devices)


def test_this_machine_has_a_working_device() -> None:
    assert any(d.works for d in list_devices())


@pytest.mark.parametrize(
    ("devices", "substring", "chosen"),
    [
        ((BROKEN, CPU), None, CPU),
        ((CPU, GPU), None, GPU),
        ((CPU, GPU), "PROCESSOR", CPU),
        ((GPU, BROKEN), "card", GPU),
    ],
)
def test_choice(
    monkeypatch: pytest.MonkeyPatch, devices: tuple[DeviceInfo, ...], substring: str | None, chosen: DeviceInfo
) -> None:
    pretend(monkeypatch, *devices)
    assert choose_device(substring) is chosen


@pytest.mark.parametrize(
    ("devices", "substring", "message", "hint"),
    [
        ((), None, "no OpenCL device was found", "apt-get install pocl-opencl-icd"),
        ((BROKEN,), None, "unknown target CPU 'generic'", "apt-get install pocl-opencl-icd"),
        ((BROKEN, CPU), "lists but", "unknown target CPU", "install"),
        ((CPU,), "nvidia", "no OpenCL device matches --device 'nvidia'", "a processor"),
    ],
)
def test_no_choice_says_why(
    monkeypatch: pytest.MonkeyPatch,
    devices: tuple[DeviceInfo, ...],
    substring: str | None,
    message: str,
    hint: str,
) -> None:
    pretend(monkeypatch, *devices)
    with pytest.raises(DeviceError, match=message) as caught:
        choose_device(substring)
    assert hint in (caught.value.hint or "")
    assert caught.value.exit_code == 5


def run_probe(environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "amslicer", "devices", "--refresh"],
        capture_output=True, text=True, env=os.environ | environment, check=False,
    )  # fmt: skip


@pytest.fixture
def fresh(tmp_path: Path) -> dict[str, str]:
    """An environment with empty caches, ours and the driver's."""
    return {"XDG_CACHE_HOME": str(tmp_path / "cache"), "POCL_CACHE_DIR": str(tmp_path / "pocl")}


def test_a_device_that_is_listed_but_cannot_build_is_seen_through(fresh: dict[str, str], tmp_path: Path) -> None:
    """PoCL without a linker lists its device and fails to build for it: the same sight as a PoCL that does not
    know the processor."""
    if not any("pocl" in d.label.lower() or "portable" in d.label.lower() for d in list_devices()):
        pytest.skip("only PoCL needs a linker")
    (tmp_path / "cache").mkdir()
    (tmp_path / "pocl").mkdir()
    done = run_probe(fresh | {"PATH": str(tmp_path)})
    assert done.returncode == 5, done.stdout
    assert "does not work" in done.stdout
    assert "no OpenCL device works" in done.stderr
    assert "Traceback" not in done.stderr


def test_no_driver_at_all(fresh: dict[str, str], tmp_path: Path) -> None:
    done = run_probe(fresh | {"OCL_ICD_VENDORS": str(tmp_path)})
    assert done.returncode == 5
    assert done.stdout == ""
    assert "hint: install one" in done.stderr


def test_verdicts_are_remembered_and_refreshed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    tried = []
    monkeypatch.setattr(device, "_probe", lambda d: tried.append(d) or "ok")
    for refresh, expected in ((False, 1), (False, 1), (True, 2)):
        found = list_devices(refresh=refresh)
        assert all(d.works for d in found)
        assert len(tried) == expected * len(found)


def test_a_failure_is_tried_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(device, "_probe", lambda d: "does not compile")
    assert not any(d.works for d in list_devices())
    monkeypatch.setattr(device, "_probe", lambda d: "ok")
    assert all(d.works for d in list_devices())


def test_a_cache_that_cannot_be_written_costs_nothing_but_time(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path / "file" / "below")
    monkeypatch.setattr(device, "_probe", lambda d: "ok")
    assert all(d.works for d in list_devices())
    with Device() as opened:
        assert opened.kernel("fill")


def test_a_damaged_cache_is_not_believed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path)
    with Device() as opened:
        opened.kernel("fill")
    kept = [p for p in tmp_path.rglob("*") if p.is_file()]
    assert kept
    for file in kept:
        file.write_bytes(b"{damaged")
    assert list_devices()
    with Device() as opened:
        assert opened.kernel("fill")


def test_a_driver_that_ends_the_process_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "_run_probe", lambda arguments: (-6, "", "aborted"))
    with pytest.raises(DeviceError, match="signal 6"):
        list_devices()


def test_what_went_wrong_ahead_is_said_once_and_then_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    answers = [(-6, "", "aborted"), (0, "[]", "")]
    monkeypatch.setattr(device, "_run_probe", lambda arguments: answers.pop(0))
    device._asked.cache_clear()
    try:
        device.ask_ahead()
        with pytest.raises(DeviceError, match="signal 6"):
            choose_device()
        with pytest.raises(DeviceError, match="no OpenCL device was found"):
            choose_device()
        assert not answers
    finally:
        device._asked.cache_clear()


def test_a_probe_does_not_outlive_a_job_that_is_refused(tmp_path: Path) -> None:
    probe, pipe = tmp_path / "probe", tmp_path / "pipe"
    os.mkfifo(pipe)
    probe.write_text(
        f"#!{sys.executable}\nimport time\nout = open({str(pipe)!r}, 'w')\nout.write('begun')\nout.flush()\n"
        "time.sleep(60)\nout.write(', survived')\n"
    )
    probe.chmod(0o755)
    job = f"import sys; from amslicer import device; sys.executable = {str(probe)!r}; device.ask_ahead(); input()"
    with (
        subprocess.Popen([sys.executable, "-c", job], stdin=subprocess.PIPE, text=True) as refused,
        pipe.open() as said,
    ):
        begun = said.read(5)
        refused.communicate("\n")
        assert begun + said.read() == "begun"


@pytest.mark.parametrize("jobs", [1, 2])
def test_jobs_bound_the_devices_threads(jobs: int) -> None:
    with Device(jobs=jobs) as opened:
        if opened.is_cpu:
            assert opened.device.max_compute_units <= jobs


def test_no_jobs_are_refused() -> None:
    with pytest.raises(UsageError, match="at least 1"):
        Device(jobs=0)


def test_too_large_a_buffer_names_both_numbers() -> None:
    with Device() as opened:
        limit = opened.device.max_mem_alloc_size
        with pytest.raises(DeviceError, match=f"{limit / 1e6:.0f} MB"):
            opened.empty(limit + 1)
