#!/usr/bin/env python3
"""Renders random scenes with `render` and with Mitsuba 3, and says which images differ.

  pip install mitsuba numpy                     (and an LLVM library, which `llvm_ad_rgb` needs)
  cargo build --release
  examples/mitsuba/random_scenes.py --seeds 0 50 --keep out/differ

A scene is a floor and one or two shapes of random materials, textures and places, under one or two lights, seen by a random
camera: all from its seed. Means of blocks of 8 x 6 pixels over independent runs of both are compared. A line is printed per
scene; files of those that differ, with what they refer to, are kept in the folder that is named, and the exit code is 1.

What is known to differ is not drawn (see `Scene files` in CONVENTIONS.md): `roughplastic`, `mask` and `blendbsdf`, numbers on
images of `principled` that only Mitsuba reads, filters that reach over the border, and `hide_emitters`.
"""
import os
import subprocess
import sys
import tempfile

from drawing import Draw, find, keep, parser, write_assets

BLOCK = (6, 8)


def parse():
    p = parser(__doc__, "render")
    p.add_argument("--runs", type=int, default=8, help="images of each renderer and scene [default: 8]")
    p.add_argument("--limit", type=float, default=9.0, help="standard errors that blocks may differ by [default: 9]")
    p.add_argument("--variant", default="llvm_ad_rgb", help="of Mitsuba 3 [default: llvm_ad_rgb]")
    args = p.parse_args()
    args.render = find(p, args, "render")
    if args.runs < 2:
        p.error("--runs: expected at least two")
    return args


def blocks(images):
    """Means of blocks of each image."""
    down, along = BLOCK
    n, height, width, channels = images.shape
    return images.reshape(n, height // down, down, width // along, along, channels).mean((2, 4))


def ours(args, path, mi, np):
    """Images of `render`, or its message."""
    images, out = [], os.path.join(os.path.dirname(path), "out.exr")
    for seed in range(args.runs):
        command = [args.render, path, "-o", out, "--spp", str(args.spp), "--seed", str(seed), "--sampler", "independent"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            return done.stderr.strip()
        bitmap = mi.Bitmap(out).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32)
        images.append(np.array(bitmap, dtype=np.float64))
    return np.array(images)


def compare(args, path, mi, np):
    """What became of a scene, and how far the two are apart."""
    try:
        scene = mi.load_file(path)
        theirs = np.array([np.array(mi.render(scene, spp=args.spp, seed=i), dtype=np.float64) for i in range(args.runs)])
    except RuntimeError as error:
        return "refused by Mitsuba", str(error).strip().splitlines()[-1]
    mine = ours(args, path, mi, np)
    if isinstance(mine, str):
        return "refused by render", mine
    a, b = blocks(theirs), blocks(mine)
    mean = a.mean(0)
    error = np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)) / args.runs) + 1e-4 * abs(mean) + 1e-6
    z = (b.mean(0) - mean) / error
    z[~np.isfinite(z)] = np.inf
    at = np.unravel_index(abs(z).argmax(), z.shape)
    found = f"|z| {abs(z[at]):.1f} in block {at[1]}, {at[0]}: Mitsuba {mean[at]:.4g}, render {b.mean(0)[at]:.4g}"
    return "same" if abs(z[at]) < args.limit else "DIFFERS", found


def main():
    args = parse()
    try:
        import mitsuba as mi
        import numpy as np
    except ImportError as error:
        sys.exit(f"{error}; expected: pip install mitsuba numpy")
    mi.set_variant(args.variant)
    mi.set_log_level(mi.LogLevel.Error)
    different = 0
    with tempfile.TemporaryDirectory() as folder:
        write_assets(folder)
        assets = os.listdir(folder)
        for seed in range(*args.seeds):
            path = os.path.join(folder, f"{seed}.xml")
            with open(path, "w") as file:
                file.write(Draw(seed).scene())
            what, found = compare(args, path, mi, np)
            print(f"{seed}: {what}; {found}", flush=True)
            if what == "DIFFERS":
                different += 1
                keep(args, folder, [*assets, f"{seed}.xml"])
    print(f"{different} of {args.seeds[1] - args.seeds[0]} differ")
    sys.exit(different > 0)


if __name__ == "__main__":
    main()
