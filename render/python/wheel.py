#!/usr/bin/env python3
"""Builds the wheel. On x86-64 it holds the native module twice: for every machine, and for those with AVX2 and FMA.

  pip install maturin wheel
  render/python/wheel.py [--out wheels]

Which one is taken is decided where it is imported (`python/render_gradients/_instructions.py`).
"""
import argparse
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "wheels"


def run(*command, **env):
    try:
        subprocess.run([str(c) for c in command], check=True, cwd=ROOT, env={**os.environ, **env})
    except FileNotFoundError as error:
        sys.exit(f"{error}; expected: pip install maturin wheel")
    except subprocess.CalledProcessError as error:
        sys.exit(f"{' '.join(error.cmd)}: exit code {error.returncode}")


def build(cpu, folder):
    """A wheel of the package, for one kind of processor."""
    options = ["--release", "--locked", "--target-dir", TARGET / cpu, "--out", folder]
    command = [sys.executable, "-m", "maturin", "build", "-m", HERE / "Cargo.toml", *options]
    run(*command, RUSTFLAGS=f"-C target-cpu={cpu}")
    (wheel,) = folder.glob("*.whl")
    return wheel


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--out", type=Path, default=ROOT / "wheels", help="folder of the wheel [default: wheels]")
    args = p.parse_args()
    out = args.out.absolute()
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        wheel = build("generic", folder / "generic")
        if platform.machine().lower() in ("x86_64", "amd64"):
            fast = build("x86-64-v3", folder / "v3")
            run(sys.executable, "-m", "wheel", "unpack", wheel, "--dest", folder)
            (unpacked,) = (f for f in folder.glob("render_gradients-*") if f.is_dir())
            inside = unpacked / "render_gradients" / "_x86_64_v3"
            inside.mkdir()
            with zipfile.ZipFile(fast) as archive:
                (module,) = (n for n in archive.namelist() if Path(n).name.startswith("_native.") and not n.endswith(".pyi"))
                (inside / Path(module).name).write_bytes(archive.read(module))
            (folder / "both").mkdir()
            run(sys.executable, "-m", "wheel", "pack", unpacked, "--dest-dir", folder / "both")
            (wheel,) = (folder / "both").glob("*.whl")
        print(shutil.copy(wheel, out))


if __name__ == "__main__":
    main()
