#!/usr/bin/env python3
"""Checks gradients of random scenes with `gradient --check`, and says which are wrong.

  cargo build --release
  examples/mitsuba/random_gradients.py --seeds 0 50 --keep out/wrong

Scenes are those of `random_scenes.py` and more: meshes with and without normals and texture coordinates, open ones and such
that are wound both ways, displaced ones, instances, things that touch and cross, masks and blends. Some parameters of each
are drawn: things that move, with estimators that see that, or (`--still`) others, with any estimator. What an estimator
refuses is counted, and why is printed with `--verbose`. A line is printed per scene, and more per derivative that is wrong;
files of these scenes, with what they refer to, are kept in the folder that is named, and the exit code is 1.

A derivative may be wrong by chance (one scene in a thousand), or by differences whose step is too large: look again with
another `--seed`, more `--spp`, and a smaller scene.
"""
import math
import os
import random
import re
import subprocess
import sys
import tempfile
from collections import Counter

from drawing import PLAIN, Draw, find, keep, parser, waves, write_assets, write_exr, write_mesh

SIZE = (24, 18)
METAL_FLOOR = '<bsdf type="twosided"><bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf></bsdf>'
WITHOUT_TEXTURE = '<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.5, 0.3"/></bsdf>'
ROUGH = ("diffuse", "diffuse", "diffuse", "roughconductor", "roughplastic", "principled")
OPAQUE = ("diffuse", "conductor", "roughconductor", "plastic", "roughplastic")
# What is written of each mesh: texture coordinates, normals.
PARTS = {"": (True, True), "-plain": (False, False), "-uv": (True, False), "-n": (False, True)}
# Of lines of `gradient --list`.
MOVES = re.compile(r"\(moves|\.displacement\.data ")
OF_MOTION = ["edges"] * 6 + ["reparameterised-exact"] * 2 + ["reparameterised-mis"]
OF_ALL = [
    *("mis", "detached", "differential-mis", "reparameterised-mis", "mis-balance", "auto", "differential", "emitter", "edges"),
    *("mis-attached-weights", "reparameterised", "mis-trust-lights", "attached", "attached-mis", "attached-path", "attached-both"),
]
# `gradient` runs this long at most, in seconds.
LONGEST = 600


def parse():
    p = parser(__doc__, "gradient")
    p.add_argument("--still", action="store_true", help="parameters of materials, textures and lights, and nothing that moves")
    p.add_argument("--repeats", type=int, default=16, help="of gradients and differences [default: 16]")
    p.add_argument("--seed", type=int, default=0, help="of the samples [default: 0]")
    p.add_argument("--threads", type=int, default=0, help="[default: one per processor]")
    p.add_argument("--verbose", action="store_true", help="print what was refused, and every derivative")
    args = p.parse_args()
    args.gradient = find(p, args, "gradient")
    return args


class Wider(Draw):
    """Scenes with more in them: such that estimators admit whatever moves, or any."""

    def __init__(self, seed, still, closed):
        super().__init__(f"gradients {seed}", SIZE)
        self.still = still
        # Outlines are to have closed forms.
        self.closed = closed
        self.depth = self.one(2, 2, 3, 4, 6)
        self.shapes = 0
        self.groups = ""

    def texture(self, name, numbers=False):
        # What jumps is refused where it moves.
        if self.still or self.chance(0.05):
            return super().texture(name, numbers)
        file = self.one("rgb.png", "grey.png", "rgba.png", "rgb.exr")
        raw = '<boolean name="raw" value="true"/>' if numbers else ""
        return f'<texture type="bitmap" name="{name}"><string name="filename" value="{file}"/>{raw}{self.to_uv()}</texture>'

    def leaf(self, kinds):
        kind = self.one(*kinds)
        base = OPAQUE if self.still else ROUGH
        body = {
            "roughplastic": lambda: self.value("diffuse_reflectance") + self.roughness(False),
            "mask": lambda: self.scalar("opacity", 0.2, 0.9, 0.6) + self.leaf(base),
            "blendbsdf": lambda: self.scalar("weight", 0.1, 0.9, 0.5) + self.leaf(base) + self.leaf(base),
        }.get(kind)
        return f'<bsdf type="{kind}">{body()}</bsdf>' if body else super().leaf((kind,))

    def material(self):
        if self.chance(0.3):
            if self.still:
                return self.leaf(("mask", "blendbsdf", "roughplastic"))
            return self.leaf(("blendbsdf", "roughplastic", "roughdielectric"))
        if self.still:
            return super().material()
        if self.chance(0.2):
            return f'<bsdf type="twosided">{self.leaf(ROUGH[:-1])}{self.perhaps(0.4, lambda: self.leaf(ROUGH[:-1]))}</bsdf>'
        return self.leaf(ROUGH)

    def mesh(self, kind):
        """A file, and options that it is read with."""
        options = ""
        if kind == "displaced":
            file = self.one("waves", "waves-uv", "ball", "ball-uv")
            options = '<texture type="bitmap" name="displacement"><string name="filename" value="heights.exr"/><boolean name="raw" value="true"/></texture>'
        else:
            file = self.one("waves", "ball") + self.one(*PARTS) if self.chance(0.6) else self.one("points", "points-open")
        flat = 1.0 if self.closed else 0.3
        options += self.perhaps(flat, lambda: '<boolean name="face_normals" value="true"/>')
        return f'<string name="filename" value="{file}.obj"/>{options}'

    def shape(self, x, z, inside):
        self.shapes += 1
        name = f"thing{self.shapes}"
        round_ones = ("sphere", "sphere", "disk", "cylinder")
        every = (*round_ones, "cube", "rectangle", "mesh", "mesh", "mesh", "instance", "displaced")
        kind = self.one("sphere", "cube", "rectangle", "mesh") if self.closed else self.one(*every)
        light = "<emitter" in inside
        if kind in round_ones and "<texture" in inside and not light and not self.still:
            # Textures begin again there.
            inside = WITHOUT_TEXTURE
        steps = {"rectangle": "", "disk": ""}.get(kind, f'<scale value="{self.number(0.4, 0.8)}"/>')
        if kind not in ("sphere", "cylinder"):
            steps += self.perhaps(0.5, lambda: f'<scale x="{self.number(0.5, 1.2)}" y="{self.number(0.5, 1.2)}" z="{self.number(0.5, 1.2)}"/>')
            steps += self.perhaps(0.2, lambda: '<scale x="-1"/>')
        steps += self.perhaps(0.85, self.rotation)
        # A light that something crosses has derivatives of large variance.
        high = (1.9, 2.4) if light and self.chance(0.85) else self.one((0.7, 1.1), (0.7, 1.1), (0.2, 0.5))
        steps += f'<translate x="{x}" y="{self.number(*high)}" z="{z}"/>'
        flip = self.perhaps(0.15, lambda: '<boolean name="flip_normals" value="true"/>')
        if kind not in ("mesh", "instance", "displaced"):
            return f'<shape type="{kind}" id="{name}">{flip}<transform name="to_world">{steps}</transform>{inside}</shape>\n'
        options = self.mesh(kind) + flip
        if kind != "instance" or light:
            return f'<shape type="obj" id="{name}">{options}<transform name="to_world">{steps}</transform>{inside}</shape>\n'
        self.groups += f'<shape type="shapegroup" id="group{name}"><shape type="obj" id="of{name}">{options}{inside}</shape></shape>\n'
        again = f'<translate x="{self.number(-0.5, 0.5)}" y="{self.number(0.2, 0.6)}" z="{self.number(-1, -0.3)}"/>'
        copy = lambda own, more: f'<shape type="instance" id="{own}"><ref id="group{name}"/><transform name="to_world">{steps}{more}</transform></shape>\n'
        return copy(name, "") + self.perhaps(0.4, lambda: copy(f"{name}b", again))

    def light(self, kind):
        tag = "<shape" if kind == "lamp" else "<emitter"
        return super().light(kind) if kind == "shape" else super().light(kind).replace(tag, f'{tag} id="{kind}"', 1)

    def lights(self):
        if self.still:
            return super().lights()
        near = ["lamp", "lamp", "shape", "shape"] + (["point", "spot"] if self.depth == 2 else [])
        kinds = [self.one(*near, "envmap", "constant")] + ([self.one(*near, "envmap")] if self.chance(0.35) else [])
        return "".join(self.light(kind) for kind in dict.fromkeys(kinds))

    def sensor(self):
        filters = ("box", "gaussian") if self.closed else ("box", "box", "gaussian", "tent")
        found = super().sensor()
        while not self.still and 'type="perspective"' not in found:
            found = super().sensor()
        return found.replace('<rfilter type="box"/>', f'<rfilter type="{self.one(*filters)}"/>')

    def scene(self):
        roulette = self.one(100, 100, 3)
        path = f'<integrator type="path"><integer name="max_depth" value="{self.depth}"/><integer name="rr_depth" value="{roulette}"/></integrator>'
        ground = '<transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform>'
        below = self.material() if self.chance(0.3) else self.one(PLAIN, METAL_FLOOR)
        floor = f'<shape type="rectangle" id="floor">{ground}{below}</shape>\n'
        places = self.one((0,), (-0.9, 0.9), (-0.3, 0.3))
        things = "".join(self.shape(x, self.number(-0.5, 0.5), self.material()) for x in places)
        rest = f"{floor}{things}{self.lights()}"
        return f'<scene version="3.0.0">\n{path}\n{self.sensor()}\n{self.groups}{rest}</scene>\n'


def ball():
    """Corners and faces of a sphere: an octahedron, each side halved twice."""
    corners, faces = points()
    places = [p for p, _, _ in corners]
    for _ in range(2):
        middles, finer = {}, []
        for face in faces:
            for k in range(3):
                pair = tuple(sorted((face[k], face[k - 1])))
                if pair not in middles:
                    middle = [x + y for x, y in zip(places[pair[0]], places[pair[1]])]
                    length = math.sqrt(sum(x * x for x in middle))
                    middles[pair] = len(places)
                    places.append(tuple(x / length for x in middle))
            a, b, c = face
            ab, bc, ca = (middles[tuple(sorted(pair))] for pair in ((a, b), (b, c), (c, a)))
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = finer
    return [(p, p, (0.5 + 0.4 * p[0], 0.5 + 0.4 * p[1])) for p in places], faces


def points():
    """Corners and faces of an octahedron."""
    places = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
    uvs = ((0.1, 0), (1, 0.1), (0, 1), (0.9, 1), (0.4, 0.6), (0.2, 0.7))
    faces = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    return [(p, p, uv) for p, uv in zip(places, uvs)], faces


def write_more(folder):
    """What scenes refer to besides, and the weights of pixels: slow waves, so that pixels at a distance do not cancel."""
    at = lambda name: os.path.join(folder, name)
    for name, mesh in (("waves", waves(6)), ("ball", ball())):
        for part, (uv, normals) in PARTS.items():
            write_mesh(at(f"{name}{part}.obj"), *mesh, uv, normals)
    corners, faces = points()
    write_mesh(at("points.obj"), corners, faces, False, False)
    # One face is missing, and one is wound the other way.
    write_mesh(at("points-open.obj"), corners, [*faces[:6], faces[6][::-1]], True, False)
    values = random.Random(2)
    write_exr(at("heights.exr"), 6, [h for _ in range(30) for h in [values.uniform(-0.06, 0.06)] * 3])
    width, height = SIZE
    weight = lambda x, y, c: 1 + 0.6 * math.cos(6.3 * x / width + c) * math.cos(5.1 * y / height + 2 * c)
    every = [weight(x, y, c) / (3 * width * height) for y in range(height) for x in range(width) for c in range(3)]
    write_exr(at("weights.exr"), width, every)


def gradient(args, path, *more):
    """Exit code, output and message."""
    threads = ["--threads", str(args.threads)] if args.threads else []
    try:
        done = subprocess.run([args.gradient, path, *threads, *more], capture_output=True, text=True, timeout=LONGEST)
    except subprocess.TimeoutExpired:
        return None, "", f"took more than {LONGEST} s"
    return done.returncode, done.stdout, done.stderr.strip()


def check(args, seed, folder, counts):
    """What became of a scene, and lines about it."""
    draw = random.Random(f"parameters {seed}")
    estimator = draw.choice(OF_ALL if args.still else OF_MOTION)
    path = os.path.join(folder, f"{seed}.xml")
    with open(path, "w") as file:
        file.write(Wider(seed, args.still, estimator == "reparameterised-exact").scene())
    code, out, message = gradient(args, path, "--list")
    if code != 0:
        return "FAILS", [message]
    names = [line.split()[0] for line in out.splitlines() if line.strip() and bool(MOVES.search(line)) != args.still]
    admitted, lines = [], []
    for name in draw.sample(names, min(4, len(names))):
        code, _, message = gradient(args, path, "--estimator", estimator, "--spp", "1", "--param", name)
        if code == 0:
            admitted.append(name)
        elif code == 1:
            counts["parameters refused"] += 1
            lines += [f"refused: {message}"] if args.verbose else []
        else:
            return "FAILS", [f"{name}: {message}"]
    if not admitted:
        return "refused", lines
    options = draw.choice([[], [], [], ["--lights", "all"], ["--sampler", "independent"], ["--sampler", "antithetic"]])
    keys = [x for name in admitted[:2] for x in ("--param", name)]
    samples = ["--spp", str(args.spp), "--repeats", str(args.repeats), "--seed", str(args.seed)]
    weights = ["--adjoint", os.path.join(folder, "weights.exr")]
    code, out, message = gradient(args, path, "--check", "--estimator", estimator, *samples, *weights, *options, *keys)
    what = {0: "right", 3: "WRONG", 4: "cannot tell"}.get(code, "FAILS")
    mark = "gradient" if args.verbose else ": WRONG"
    lines += [line for line in out.splitlines() if mark in line or "not finite" in line]
    return what, [" ".join([estimator, *options, *admitted[:2]]), *lines, *([message] if what == "FAILS" else [])]


def main():
    args = parse()
    counts = Counter()
    with tempfile.TemporaryDirectory() as folder:
        write_assets(folder)
        write_more(folder)
        assets = os.listdir(folder)
        for seed in range(*args.seeds):
            what, lines = check(args, seed, folder, counts)
            counts[what] += 1
            print(f"{seed}: {what}; " + "\n    ".join(lines), flush=True)
            if what in ("WRONG", "FAILS"):
                keep(args, folder, [*assets, f"{seed}.xml"])
    print(", ".join(f"{n} {what}" for what, n in sorted(counts.items())))
    sys.exit(counts["WRONG"] + counts["FAILS"] > 0)


if __name__ == "__main__":
    main()
