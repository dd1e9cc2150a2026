"""What users install: a wheel that works outside the checkout, and an import that costs nothing."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import pkgutil
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

import amslicer

REPOSITORY = Path(__file__).parents[1]
NOT_SOURCE = shutil.ignore_patterns(".*", "__pycache__", "build", "dist", "demo-*", "bench-*", "*.egg-info")
# The functions of the Python API, those of later versions too.
FUNCTIONS = ("load_job", "layers", "slice_job", "open_stack", "verify", "field", "batch", "sweep")


def run(command: Sequence[str | Path], **options: object) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(command, capture_output=True, text=True, **options)  # type: ignore[call-overload]
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done


def python(code: str) -> str:
    """What a fresh interpreter prints; it must not say anything else."""
    done = run([sys.executable, "-W", "error", "-c", code], cwd=REPOSITORY)
    assert done.stderr == ""
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel of a copy of the repository."""
    source = tmp_path_factory.mktemp("source") / "amslicer"
    shutil.copytree(REPOSITORY, source, ignore=NOT_SOURCE, symlinks=True)
    out = tmp_path_factory.mktemp("wheel")
    isolation = ["--no-isolation"] if importlib.util.find_spec("hatchling") else []
    run([sys.executable, "-m", "build", "--wheel", *isolation, "--outdir", out, source])
    (built,) = out.iterdir()
    return built


def test_the_wheel_holds_kernels_and_printers_and_no_tests(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
        entry_points = next(n for n in archive.namelist() if n.endswith("entry_points.txt"))
        scripts = archive.read(entry_points).decode()
    for folder in ("cl", "configs"):
        expected = {
            f"amslicer/{file.relative_to(REPOSITORY).as_posix()}"
            for file in (REPOSITORY / folder).rglob("*")
            if file.is_file()
        }
        assert expected
        assert {name for name in names if name.startswith(f"amslicer/{folder}/")} == expected
    assert {Path(name).suffix for name in names if name.startswith("amslicer/cl/")} == {".cl", ".h"}
    assert "amslicer/configs/printers/generic-600dpi.yaml" in names
    assert "amslicer/py.typed" in names
    assert {name.split("/")[0] for name in names} == {"amslicer"}
    # amslicer.testing is public, for the tests of others; of our own none is there.
    assert [name for name in names if "test" in name or "sample" in name] == ["amslicer/testing.py"]
    assert "amslicer = amslicer.cli:main" in scripts


def test_the_wheel_slices_outside_the_checkout_in_a_path_with_a_space(wheel: Path, tmp_path: Path) -> None:
    site = tmp_path / "a folder with a space" / "site"
    run([sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--quiet", "--target", site, wheel])
    work = tmp_path / "my prints"
    shutil.copytree(REPOSITORY / "samples" / "cross_plate", work / "cross plate")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "COV"))}
    environment |= {"PYTHONPATH": str(site), "PYTHONSAFEPATH": "1"}

    def installed(*arguments: str) -> str:
        return run([sys.executable, *arguments], cwd=work, env=environment).stdout

    found = installed("-c", "import amslicer; print(amslicer.__file__)").strip()
    assert Path(found) == site / "amslicer" / "__init__.py"
    folders = installed(
        "-c", "from amslicer.resources import resource_folder as f; print(f('cl')); print(f('configs'))"
    ).splitlines()
    assert [Path(folder) for folder in folders] == [site / "amslicer" / "cl", site / "amslicer" / "configs"]
    assert "generic-300dpi" in installed("-m", "amslicer", "printers")
    installed(
        "-m", "amslicer", "cross plate/cross_plate.stl", "--fields", "cross plate/fields.yaml",
        "--printer", "generic-300dpi", "--layers", "0:4", "-o", "the stack",
    )  # fmt: skip
    for material in ("rigid", "flexible"):
        pictures = sorted(file.name for file in (work / "the stack" / material).iterdir())
        assert pictures == ["00000.png", "00001.png", "00002.png", "00003.png"]
    manifest = json.loads((work / "the stack" / "manifest.json").read_text(encoding="utf-8"))
    assert (manifest["format"], manifest["complete"]) == ("amslicer-stack", False)
    installed("-m", "amslicer", "verify", "the stack")


def test_importing_is_quiet_and_light() -> None:
    code = "import sys; before = set(sys.modules); import amslicer; print(*(set(sys.modules) - before))"
    loaded = set(python(code).split())
    assert loaded
    heavy = {"numpy", "pyopencl", "trimesh", "scipy", "PIL", "pydantic", "ruamel", "rich", "lib3mf", "manifold3d"}
    assert not {name.split(".")[0] for name in loaded} & heavy


def test_importing_prints_nothing() -> None:
    assert python("import amslicer") == ""


def test_importing_opens_no_file_of_ours() -> None:
    """Nothing but Python's own reading of modules."""
    code = (
        "import sys; opened = []; "
        "sys.addaudithook(lambda event, args: event == 'open' and opened.append(str(args[0]))); "
        "import amslicer; print(*[f for f in opened if not f.endswith(('.py', '.pyc')) and '__pycache__' not in f])"
    )
    assert python(code).strip() == ""


@pytest.mark.parametrize("name", amslicer.__all__)
def test_every_public_name_resolves(name: str) -> None:
    assert getattr(amslicer, name) is not None


def test_the_public_names_are_listed_once_and_sorted() -> None:
    assert len(set(amslicer.__all__)) == len(amslicer.__all__)
    assert set(dir(amslicer)) >= set(amslicer.__all__)
    assert {"load_job", "layers", "slice_job", "open_stack", "verify", "field", "AmslicerError"} <= set(
        amslicer.__all__
    )


def test_a_name_that_is_not_there() -> None:
    with pytest.raises(AttributeError, match="'amslicer' has no attribute 'slice_jobs'"):
        amslicer.slice_jobs  # noqa: B018


def modules() -> list[str]:
    return [m.name for m in pkgutil.walk_packages(amslicer.__path__, "amslicer.") if not m.name.endswith("__main__")]


def test_no_module_is_named_like_a_public_function() -> None:
    top = {name.removeprefix("amslicer.") for name in modules()}
    assert "job" in top
    assert not top & set(FUNCTIONS)
    assert not top & set(amslicer.__all__)


def test_loading_every_module_hides_no_public_name() -> None:
    public = {name: getattr(amslicer, name) for name in amslicer.__all__}
    for name in modules():
        importlib.import_module(name)
    for name, value in public.items():
        assert getattr(amslicer, name) is value


def test_every_error_is_an_amslicer_error_with_its_own_exit_code() -> None:
    """The codes of the command line: 2 usage, 3 job, 4 part, 5 device, 6 files, 7 a check."""
    codes = {
        amslicer.UsageError: 2,
        amslicer.JobError: 3,
        amslicer.PartError: 4,
        amslicer.DeviceError: 5,
        amslicer.StorageError: 6,
        amslicer.CheckFailed: 7,
    }
    for kind, code in codes.items():
        assert issubclass(kind, amslicer.AmslicerError)
        assert kind.exit_code == code
        assert str(kind("what", hint="try")) == "what\nhint: try"
        assert str(kind("what")) == "what"
    assert set(amslicer.AmslicerError.__subclasses__()) == set(codes)


def test_the_version_is_that_of_the_project() -> None:
    import tomllib

    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert amslicer.__version__ == project["version"]
