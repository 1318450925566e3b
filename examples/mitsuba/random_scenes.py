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
import argparse
import math
import os
import random
import shutil
import subprocess
import sys
import tempfile

WIDTH, HEIGHT = 32, 24
BLOCK = (6, 8)
METALS = ["Au", "Cu", "Ag", "Al", "none"]
PLAIN = '<bsdf type="diffuse"/>'


def parse():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--seeds", type=int, nargs=2, default=[0, 20], metavar=("FROM", "TO"), help="[default: 0 20]")
    p.add_argument("--runs", type=int, default=8, help="images of each renderer and scene [default: 8]")
    p.add_argument("--spp", type=int, default=128, help="samples per pixel of each [default: 128]")
    p.add_argument("--limit", type=float, default=9.0, help="standard errors that blocks may differ by [default: 9]")
    p.add_argument("--binaries", default="target/release", help="folder of `render` [default: target/release]")
    p.add_argument("--variant", default="llvm_ad_rgb", help="of Mitsuba 3 [default: llvm_ad_rgb]")
    p.add_argument("--keep", metavar="FOLDER", help="for the files of scenes that differ")
    args = p.parse_args()
    args.render = os.path.abspath(os.path.join(args.binaries, "render"))
    if not os.path.exists(args.render):
        p.error(f"{args.render}: expected a file, found none")
    if args.runs < 2:
        p.error("--runs: expected at least two")
    return args


class Draw:
    """Parts of a scene, from a seed."""

    def __init__(self, seed):
        self.random = random.Random(seed)

    def chance(self, part):
        return self.random.random() < part

    def one(self, *of):
        return self.random.choice(of)

    def number(self, low, high):
        return f"{self.random.uniform(low, high):.4f}"

    def colour(self, low, high):
        return ", ".join(self.number(low, high) for _ in range(3))

    def rgb(self, name, low, high):
        return f'<rgb name="{name}" value="{self.colour(low, high)}"/>'

    def rotation(self):
        axis = [self.random.gauss(0, 1) for _ in range(3)]
        length = math.sqrt(sum(a * a for a in axis))
        x, y, z = (f"{a / length:.9f}" for a in axis)
        return f'<rotate x="{x}" y="{y}" z="{z}" angle="{self.number(-180, 180)}"/>'

    def to_uv(self):
        steps = "".join(
            self.one(
                f'<scale x="{self.number(0.5, 3)}" y="{self.number(0.5, 3)}"/>',
                f'<translate x="{self.number(-1, 1)}" y="{self.number(-1, 1)}"/>',
                f'<rotate z="1" angle="{self.number(-90, 90)}"/>',
            )
            for _ in range(self.random.randint(0, 2))
        )
        return f'<transform name="to_uv">{steps}</transform>' if steps else ""

    def texture(self, name, numbers=False):
        if self.chance(0.35):
            value = (lambda k: f'<float name="{k}" value="{self.number(0.1, 0.9)}"/>') if numbers else (lambda k: self.rgb(k, 0.1, 0.9))
            return f'<texture type="checkerboard" name="{name}">{value("color0")}{value("color1")}{self.to_uv()}</texture>'
        options = ""
        if self.chance(0.4):
            options += f'<string name="filter_type" value="{self.one("bilinear", "nearest")}"/>'
        if self.chance(0.5):
            options += f'<string name="wrap_mode" value="{self.one("repeat", "mirror", "clamp")}"/>'
        if self.chance(0.4) or numbers:
            options += f'<boolean name="raw" value="{self.one("true", "false")}"/>'
        file = self.one("rgb.png", "grey.png", "rgba.png", "rgb.exr")
        return f'<texture type="bitmap" name="{name}"><string name="filename" value="{file}"/>{options}{self.to_uv()}</texture>'

    def value(self, name, low=0.05, high=0.9, textured=0.4):
        return self.texture(name) if self.chance(textured) else self.rgb(name, low, high)

    def scalar(self, name, low=0.05, high=0.95, textured=0.25):
        if self.chance(textured):
            return self.texture(name, numbers=True)
        return f'<float name="{name}" value="{self.number(low, high)}"/>'

    def perhaps(self, part, what):
        return what() if self.chance(part) else ""

    def roughness(self, textured=True):
        facets = f'<string name="distribution" value="{self.one("ggx", "beckmann")}"/>'
        if not textured:
            return f'<float name="alpha" value="{self.number(0.1, 0.5)}"/>{facets}'
        if self.chance(0.3):
            return f'<float name="alpha_u" value="{self.number(0.1, 0.5)}"/><float name="alpha_v" value="{self.number(0.1, 0.5)}"/>{facets}'
        return self.scalar("alpha", 0.05, 0.5, 0.3) + facets

    def metal(self):
        if self.chance(0.5):
            return f'<string name="material" value="{self.one(*METALS)}"/>'
        return self.rgb("eta", 0.2, 2) + self.rgb("k", 1, 4)

    def principled(self):
        body = self.value("base_color") + self.scalar("roughness", 0.2, 0.9)
        for name in ("metallic", "anisotropic", "spec_trans", "sheen", "clearcoat", "flatness", "spec_tint"):
            body += self.perhaps(0.35, lambda: self.scalar(name))
        index = lambda: self.one(f'<float name="eta" value="{self.number(1.2, 1.8)}"/>', f'<float name="specular" value="{self.number(0.1, 0.9)}"/>')
        return body + self.perhaps(0.4, index)

    def leaf(self, kinds):
        kind = self.one(*kinds)
        reflects = lambda part, name="specular_reflectance": self.perhaps(part, lambda: self.value(name))
        index = f'<float name="int_ior" value="{self.number(1.1, 1.8)}"/>'
        body = {
            "diffuse": lambda: self.value("reflectance"),
            "conductor": lambda: self.metal() + reflects(0.4),
            "roughconductor": lambda: self.metal() + self.roughness() + reflects(0.4),
            "dielectric": lambda: index + reflects(0.3) + reflects(0.4, "specular_transmittance"),
            "thindielectric": lambda: index + reflects(0.3) + reflects(0.4, "specular_transmittance"),
            "roughdielectric": lambda: index + self.roughness(False) + reflects(0.3) + reflects(0.4, "specular_transmittance"),
            "plastic": lambda: index + self.value("diffuse_reflectance") + self.perhaps(0.5, lambda: '<boolean name="nonlinear" value="true"/>'),
            "principled": self.principled,
            "null": lambda: "",
        }[kind]()
        return f'<bsdf type="{kind}">{body}</bsdf>'

    def material(self):
        opaque = ("diffuse", "conductor", "roughconductor", "plastic")
        every = (*opaque, "diffuse", "roughconductor", "dielectric", "thindielectric", "roughdielectric", "principled", "null")
        raw = '<boolean name="raw" value="true"/>'
        kind = self.random.random()
        if kind < 0.2:
            return f'<bsdf type="twosided">{self.leaf(opaque)}{self.perhaps(0.4, lambda: self.leaf(opaque))}</bsdf>'
        if kind < 0.28:
            return f'<bsdf type="normalmap"><texture type="bitmap" name="normalmap"><string name="filename" value="normal.png"/>{raw}</texture>{self.leaf(opaque)}</bsdf>'
        if kind < 0.36:
            scale = f'<float name="scale" value="{self.number(0.005, 0.03)}"/>'
            return f'<bsdf type="bumpmap"><texture type="bitmap" name="map"><string name="filename" value="grey.png"/>{raw}</texture>{scale}{self.leaf(opaque)}</bsdf>'
        return self.leaf(every)

    def shape(self, x, z, inside):
        kind = self.one("sphere", "sphere", "cube", "rectangle", "disk", "cylinder", "obj", "ply")
        steps, options = "", ""
        if kind in ("sphere", "cylinder"):
            steps = f'<scale value="{self.number(0.4, 0.9)}"/>'
        else:
            steps += {"cube": '<scale value="0.6"/>', "obj": '<scale value="0.8"/>', "ply": '<scale value="0.8"/>'}.get(kind, "")
            steps += self.perhaps(0.5, lambda: f'<scale x="{self.number(0.5, 1.2)}" y="{self.number(0.5, 1.2)}" z="{self.number(0.5, 1.2)}"/>')
            steps += self.perhaps(0.2, lambda: '<scale x="-1"/>')
        steps += self.rotation() + f'<translate x="{x}" y="{self.number(0.7, 1.1)}" z="{z}"/>'
        if kind in ("obj", "ply"):
            options = f'<string name="filename" value="waves.{kind}"/>'
            options += self.perhaps(0.3, lambda: '<boolean name="face_normals" value="true"/>')
        options += self.perhaps(0.15, lambda: '<boolean name="flip_normals" value="true"/>')
        return f'<shape type="{kind}">{options}<transform name="to_world">{steps}</transform>{inside}</shape>\n'

    def light(self, kind):
        aimed = '<transform name="to_world"><lookat origin="1.5, 3, 2" target="0, 0.3, 0" up="0, 0, 1"/></transform>'
        above = '<transform name="to_world"><scale value="0.8"/><rotate x="1" angle="90"/><translate y="3" z="0.5"/></transform>'
        if kind == "lamp":
            radiance = self.value("radiance", 2, 8, 0.3)
            return f'<shape type="rectangle">{above}<emitter type="area">{radiance}</emitter></shape>'
        if kind == "shape":
            return self.shape(1.2, 0.6, f'<emitter type="area">{self.rgb("radiance", 2, 8)}</emitter>')
        turn = f'<rotate y="1" angle="{self.number(-180, 180)}"/>' + self.perhaps(0.4, lambda: f'<rotate x="1" angle="{self.number(-40, 40)}"/>')
        body = {
            "envmap": lambda: f'<string name="filename" value="rgb.exr"/><float name="scale" value="{self.number(0.5, 2)}"/><transform name="to_world">{turn}</transform>',
            "constant": lambda: self.rgb("radiance", 0.3, 1),
            "point": lambda: '<point name="position" value="1, 2.5, 1.5"/>' + self.rgb("intensity", 3, 9),
            "directional": lambda: '<vector name="direction" value="-0.4, -1, -0.5"/>' + self.rgb("irradiance", 1, 3),
            "spot": lambda: f'{aimed}<float name="cutoff_angle" value="{self.number(20, 50)}"/>' + self.rgb("intensity", 5, 12) + self.perhaps(0.3, lambda: self.texture("texture")),
            "projector": lambda: f'{aimed}<float name="fov" value="{self.number(20, 60)}"/><float name="scale" value="{self.number(1, 5)}"/>' + self.texture("irradiance"),
        }[kind]()
        return f'<emitter type="{kind}">{body}</emitter>\n'

    def lights(self):
        near = ["lamp", "lamp", "point", "spot", "directional", "projector", "shape"]
        kinds = [self.one(*near, "envmap", "constant")] + ([self.one(*near)] if self.chance(0.35) else [])
        # Two lamps above would be in the same place.
        return "".join(self.light(kind) for kind in dict.fromkeys(kinds))

    def sensor(self):
        kind = self.one("perspective", "perspective", "perspective", "thinlens", "orthographic")
        pixels = f'<integer name="width" value="{WIDTH}"/><integer name="height" value="{HEIGHT}"/>'
        film = f'<film type="hdrfilm">{pixels}<string name="pixel_format" value="rgb"/><rfilter type="box"/></film>'
        seen = '<lookat origin="0.3, 1.8, 5" target="0, 0.7, 0" up="0, 1, 0"/>'
        if kind == "orthographic":
            return f'<sensor type="orthographic"><transform name="to_world"><scale x="2" y="2"/>{seen}</transform>{film}</sensor>'
        options = f'<float name="fov" value="40"/><string name="fov_axis" value="{self.one("x", "y", "smaller", "larger", "diagonal")}"/>'
        if kind == "thinlens":
            options += '<float name="aperture_radius" value="0.08"/><float name="focus_distance" value="4.5"/>'
        elif self.chance(0.3):
            options += f'<float name="principal_point_offset_x" value="{self.number(-0.1, 0.1)}"/>'
        return f'<sensor type="{kind}">{options}<transform name="to_world">{seen}</transform>{film}</sensor>'

    def scene(self):
        depth = self.one(2, 3, 5, 7)
        path = f'<integrator type="path"><integer name="max_depth" value="{depth}"/><integer name="rr_depth" value="100"/></integrator>'
        ground = '<transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform>'
        floor = f'<shape type="rectangle">{ground}{self.material() if self.chance(0.4) else PLAIN}</shape>\n'
        shapes = "".join(self.shape(x, self.number(-0.5, 0.5), self.material()) for x in self.one((0,), (-0.9, 0.9)))
        return f'<scene version="3.0.0">\n{path}\n{self.sensor()}\n{floor}{shapes}{self.lights()}</scene>\n'


def write_assets(folder, mi, np):
    """Images and a mesh that scenes refer to."""
    values = np.random.default_rng(1)
    at = lambda name: os.path.join(folder, name)
    for name, shape in (("rgb.png", (5, 7, 3)), ("grey.png", (6, 4, 1)), ("rgba.png", (5, 7, 4))):
        mi.Bitmap((values.random(shape) * 255).astype(np.uint8)).write(at(name))
    normals = values.random((8, 8, 3))
    normals[..., :2] = 0.5 + 0.25 * (normals[..., :2] - 0.5)
    normals[..., 2] = 0.95
    mi.Bitmap((normals * 255).astype(np.uint8)).write(at("normal.png"))
    mi.Bitmap(values.random((16, 32, 3)).astype(np.float32)).write(at("rgb.exr"))
    n = 12
    corners, faces = [], []
    for i in range(n + 1):
        for j in range(n + 1):
            a, b = 2 * i / n - 1, 2 * j / n - 1
            slopes = (0.9 * math.cos(3 * a) * math.cos(2 * b), -0.6 * math.sin(3 * a) * math.sin(2 * b))
            length = math.sqrt(slopes[0] ** 2 + slopes[1] ** 2 + 1)
            normal = (-slopes[0] / length, -slopes[1] / length, 1 / length)
            corners.append(((a, b, 0.3 * math.sin(3 * a) * math.cos(2 * b)), normal, (i / n, j / n)))
            if i < n and j < n:
                k = i * (n + 1) + j
                faces += [(k, k + n + 1, k + n + 2), (k, k + n + 2, k + 1)]
    row = lambda numbers: " ".join(f"{x:.6f}" for x in numbers)
    with open(at("waves.obj"), "w") as file:
        for p, normal, uv in corners:
            file.write(f"v {row(p)}\nvt {row(uv)}\nvn {row(normal)}\n")
        for face in faces:
            file.write("f " + " ".join(f"{k + 1}/{k + 1}/{k + 1}" for k in face) + "\n")
    with open(at("waves.ply"), "w") as file:
        properties = "".join(f"property float {k}\n" for k in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
        file.write(f"ply\nformat ascii 1.0\nelement vertex {len(corners)}\n{properties}")
        file.write(f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n")
        for p, normal, uv in corners:
            file.write(f"{row(p)} {row(normal)} {row(uv)}\n")
        for face in faces:
            file.write("3 %d %d %d\n" % face)


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
        write_assets(folder, mi, np)
        assets = os.listdir(folder)
        for seed in range(*args.seeds):
            path = os.path.join(folder, f"{seed}.xml")
            with open(path, "w") as file:
                file.write(Draw(seed).scene())
            what, found = compare(args, path, mi, np)
            print(f"{seed}: {what}; {found}", flush=True)
            if what == "DIFFERS":
                different += 1
                if args.keep:
                    os.makedirs(args.keep, exist_ok=True)
                    for name in [*assets, f"{seed}.xml"]:
                        shutil.copy(os.path.join(folder, name), args.keep)
    print(f"{different} of {args.seeds[1] - args.seeds[0]} differ")
    sys.exit(different > 0)


if __name__ == "__main__":
    main()
