"""Of a module that is there twice, the one is taken that this processor runs."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import render_gradients
from render_gradients import _native


def module_in(folder: Path, **env: str) -> subprocess.CompletedProcess[str]:
    """What a new interpreter says of the module that it takes from the package in a folder."""
    program = "import render_gradients as rg; rg.load_string; print(rg._native.__file__)"
    # Alone: an installation of the package would stand before the folder otherwise.
    program = f"import sys; sys.path.insert(0, {str(folder)!r}); {program}"
    return subprocess.run([sys.executable, "-c", program], env={**os.environ, **env}, capture_output=True, text=True)


@pytest.fixture
def twice(tmp_path: Path) -> Path:
    package = tmp_path / "render_gradients"
    shutil.copytree(Path(render_gradients.__file__).parent, package, ignore=shutil.ignore_patterns("_x86_64_v3"))
    module = next(package.glob("_native.*[!i]"))
    (package / "_x86_64_v3").mkdir()
    shutil.copy(module, package / "_x86_64_v3")
    return tmp_path


def test_the_processor_decides(twice: Path) -> None:
    done = module_in(twice)
    assert done.returncode == 0, done.stderr
    chosen = Path(done.stdout.strip()).parent.name
    assert chosen == ("_x86_64_v3" if _native.has_x86_64_v3() else "render_gradients")


def test_the_generic_module_can_be_asked_for(twice: Path) -> None:
    done = module_in(twice, RENDER_GRADIENTS_INSTRUCTIONS="generic")
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()).parent.name == "render_gradients"


def test_other_choices_are_refused_by_name(twice: Path) -> None:
    done = module_in(twice, RENDER_GRADIENTS_INSTRUCTIONS="avx9")
    assert done.returncode != 0
    assert "expected best or generic, found 'avx9'" in done.stderr


def test_one_module_is_enough(twice: Path) -> None:
    shutil.rmtree(twice / "render_gradients" / "_x86_64_v3")
    done = module_in(twice)
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()).parent.name == "render_gradients"
