#!/usr/bin/env python3
"""Compares `gradient` and `render` with Mitsuba 3: the same scene file, the same machine, in turn.

  pip install mitsuba numpy                     (and an LLVM library, which `llvm_ad_rgb` needs)
  cargo build --release
  examples/mitsuba/against_mitsuba.py examples/scenes/cornell.xml --param red.reflectance.value \\
      --ours "--estimator mis" --ours "--estimator mis --sampler sobol"
  examples/mitsuba/against_mitsuba.py examples/scenes/cornell.xml --ours "" --ours "--sampler sobol" --ours=--guide

With `--param`, derivatives of the mean of all pixels and channels are compared; without, images. Both sides
render the same number of samples (unless `--ours` gives another) with independent seeds, in rounds that
alternate, so that a slow phase of the machine meets both. Printed per `--ours`, as Mitsuba's number over
ours, so that more is better:

  variance    of one pass: sum over all derivatives, and the geometric mean of each one's ratio; of an image
              the mean over its values of variance / (mean^2 + 0.01)
  time        wall clock of one pass: median over the rounds of the ratio within a round
  efficiency  1 / (variance x time), with the sum of variances; the second with the time that pilots
              (--measure-lights, --measure-pixels, auto) take added to every single pass
  |z|         largest difference of the two means in standard errors, over all derivatives, or the three colours
              of the image's mean

A variance of n passes is known to sqrt(2 / (n - 1)): 30 % for 24, if passes are nearly normal. Over the pixels of
an image that averages out, except where rare samples carry it.
"""
import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from xml.etree import ElementTree


def parse():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("scene", help="scene file that both read")
    p.add_argument("--param", action="append", default=[], metavar="KEY", help="its name in both, or MITSUBAS=OURS")
    p.add_argument("--ours", action="append", metavar="ARGS", help="arguments of `gradient` or `render` [default: none]")
    p.add_argument("-D", "--define", action="append", default=[], metavar="NAME=VALUE")
    p.add_argument("--spp", type=int, default=64, help="samples per pixel and pass [default: 64]")
    p.add_argument("--repeats", type=int, default=24, help="passes of each [default: 24]")
    p.add_argument("--rounds", type=int, default=6, help="in so many turns [default: 6]")
    p.add_argument("--binaries", default="target/release", help="folder of both tools [default: target/release]")
    p.add_argument("--variant", default="llvm_ad_rgb", help="of Mitsuba 3 [default: llvm_ad_rgb]")
    p.add_argument("--integrator", default="prb", help="of Mitsuba's gradients [default: prb]")
    p.add_argument("--json", metavar="OUT", help="write the numbers to this file")
    args = p.parse_args()
    if args.rounds < 1 or args.repeats < 2 * args.rounds:
        p.error("--repeats: expected at least two for each of --rounds")
    args.binary = os.path.join(args.binaries, "gradient" if args.param else "render")
    for path in (args.scene, args.binary):
        if not os.path.exists(path):
            p.error(f"{path}: expected a file, found none")
    names = [key.partition("=") for key in args.param]
    args.theirs = [theirs for theirs, _, _ in names]
    args.param = [ours or theirs for theirs, _, ours in names]
    for define in args.define:
        if "=" not in define:
            p.error(f"--define: expected NAME=VALUE, found {define!r}")
    return args


def depths(args):
    """Largest depth and depth of roulette, which Mitsuba's integrator does not tell: from the scene file."""
    root = ElementTree.parse(args.scene).getroot()
    values = {d.get("name"): d.get("value") for d in root.iter("default")}
    values.update(d.split("=", 1) for d in args.define)
    found = {}
    for node in root.findall("integrator/integer"):
        text = node.get("value")
        value = values.get(text[1:]) if text.startswith("$") else text
        if value is None:
            sys.exit(f"{args.scene}: no value for {text}; expected a <default>, or --define {text[1:]}=VALUE")
        found[node.get("name")] = int(value)
    return {k: v for k, v in found.items() if k in ("max_depth", "rr_depth")}


class Mitsuba:
    """Mitsuba: gradients and images, timed until they are known."""

    def __init__(self, args):
        try:
            import drjit
            import mitsuba
            import numpy
        except ImportError as error:
            sys.exit(f"{error}; expected: pip install mitsuba numpy")
        mitsuba.set_variant(args.variant)
        mitsuba.set_log_level(mitsuba.LogLevel.Error)
        if hasattr(os, "sched_getaffinity"):
            # Both sides use the processors that this process may use, and no others.
            drjit.set_thread_count(len(os.sched_getaffinity(0)))
        self.mi, self.dr, self.np = mitsuba, drjit, numpy
        self.spp, self.keys = args.spp, args.theirs
        self.scene = mitsuba.load_file(args.scene, **dict(d.split("=", 1) for d in args.define))
        self.primal = self.scene.integrator()
        self.prb = mitsuba.load_dict({"type": args.integrator, **depths(args)})
        self.params = mitsuba.traverse(self.scene)
        unknown = [k for k in self.keys if k not in self.params]
        if unknown:
            sys.exit(f"{args.scene}: Mitsuba 3 knows no parameter {unknown[0]!r}, but {sorted(self.params.keys())}")
        for key in self.keys:
            drjit.enable_grad(self.params[key])
        self.params.update()

    def image(self, seed):
        start = time.perf_counter()
        image = self.mi.render(self.scene, integrator=self.primal, spp=self.spp, seed=seed)
        self.dr.eval(image)
        self.dr.sync_thread()
        return time.perf_counter() - start, self.np.array(image, dtype=self.np.float64)

    def read(self, path):
        bitmap = self.mi.Bitmap(path).convert(self.mi.Bitmap.PixelFormat.RGB, self.mi.Struct.Type.Float32)
        return self.np.array(bitmap, dtype=self.np.float64)

    def gradient(self, seed, shape):
        for key in self.keys:
            self.dr.set_grad(self.params[key], 0)
        adjoint = self.dr.full(self.mi.TensorXf, 1 / math.prod(shape), shape)
        start = time.perf_counter()
        self.prb.render_backward(self.scene, self.params, adjoint, seed=seed, spp=self.spp)
        gradients = [self.dr.grad(self.params[key]) for key in self.keys]
        self.dr.eval(gradients)
        self.dr.sync_thread()
        seconds = time.perf_counter() - start
        flat = [self.np.array(g, dtype=self.np.float64).ravel() for g in gradients]
        return seconds, self.np.concatenate(flat)


def run(command, options):
    done = subprocess.run(command + options.split(), capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)} {options}\n{done.stderr}")


def common(args, options, folder, seed):
    """What both our tools are called with, and the report that they write."""
    report = os.path.join(folder, "out.json")
    command = [args.binary, args.scene, "--json", report, "--seed", str(seed)]
    if "--spp" not in options.split():
        command += ["--spp", str(args.spp)]
    for define in args.define:
        command += ["-D", define]
    return command, report


def our_gradient(args, options, repeats, seed):
    """Means, variances of one pass, and seconds of our `gradient`."""
    with tempfile.TemporaryDirectory() as folder:
        command, out = common(args, options, folder, seed)
        command += ["--repeats", str(repeats)]
        for key in args.param:
            command += ["--param", key]
        run(command, options)
        with open(out) as file:
            report = json.load(file)
    mean, variance = [], []
    for key in args.param:
        values = report["params"][key]
        if isinstance(values["gradient"], str):
            sys.exit(f"{key}: textures are written as images, which this script does not read")
        mean += values["gradient"]
        variance += [error * error * repeats for error in values["std_error"]]
    seconds = {k: report[f"seconds_{k}"] for k in ("primal", "gradient", "pilots")}
    return mean, variance, seconds


def our_image(args, options, mitsuba, seed):
    """Seconds and image of our `render`."""
    with tempfile.TemporaryDirectory() as folder:
        command, out = common(args, options, folder, seed)
        image = os.path.join(folder, "out.exr")
        run(command + ["-o", image], options)
        with open(out) as file:
            return json.load(file)["seconds_render"], mitsuba.read(image)


class Images:
    """Sums over images of one kind."""

    def __init__(self):
        self.n, self.sum, self.squares, self.means = 0, 0.0, 0.0, []

    def add(self, image):
        self.n += 1
        self.sum = self.sum + image
        self.squares = self.squares + image * image
        self.means.append(image.mean((0, 1)))

    def variance(self):
        return (self.squares - self.sum * self.sum / self.n) / (self.n - 1)

    def largest_z(self, other, np):
        a, b = np.array(self.means), np.array(other.means)
        error = np.sqrt(a.var(0, ddof=1) / len(a) + b.var(0, ddof=1) / len(b))
        return float((abs(a.mean(0) - b.mean(0)) / error).max())


def median(values):
    values = sorted(values)
    half = len(values) // 2
    return values[half] if len(values) % 2 else 0.5 * (values[half - 1] + values[half])


def pooled(rounds):
    """Mean and variance of one pass, over rounds of equally many; each round holds (means, variances)."""
    n = len(rounds)
    columns = list(zip(*(zip(mean, variance) for mean, variance in rounds)))
    return [(sum(m for m, _ in c) / n, sum(v for _, v in c) / n) for c in columns]


def compare_images(args, options, mitsuba, each):
    mitsuba.image(0)  # compiles
    theirs, mine, times = Images(), [Images() for _ in options], []
    for r in range(args.rounds):
        print(f"round {r + 1} of {args.rounds}", file=sys.stderr)
        seconds = [[] for _ in range(1 + len(options))]
        for seed in range(1 + r * each, 1 + (r + 1) * each):
            taken, image = mitsuba.image(seed)
            theirs.add(image)
            seconds[0].append(taken)
            for i, option in enumerate(options):
                taken, image = our_image(args, option, mitsuba, 1_000_000 + seed)
                mine[i].add(image)
                seconds[1 + i].append(taken)
        times.append([median(s) for s in seconds])
    scale = ((theirs.sum + sum(m.sum for m in mine)) / (theirs.n * (1 + len(mine)))) ** 2 + 0.01
    print(f"{'':44} {'variance':>9} {'time':>6} {'efficiency':>10} {'|z|':>5}")
    for i, option in enumerate(options):
        found = {
            "arguments": option,
            "variance": float((theirs.variance() / scale).mean() / (mine[i].variance() / scale).mean()),
            "time": median([t[0] / t[1 + i] for t in times]),
            "largest_z": mine[i].largest_z(theirs, mitsuba.np),
        }
        found["efficiency"] = found["variance"] * found["time"]
        print(
            f"{option or '(defaults)':44} {found['variance']:9.2f} {found['time']:6.2f} {found['efficiency']:10.2f} "
            f"{found['largest_z']:5.1f}"
        )
        yield found


def compare_gradients(args, options, mitsuba, each):
    repeats = each * args.rounds
    shape = mitsuba.image(0)[1].shape
    mitsuba.gradient(0, shape)  # compiles
    theirs, mine, times = [], [[] for _ in options], []
    for r in range(args.rounds):
        print(f"round {r + 1} of {args.rounds}", file=sys.stderr)
        seeds = range(1 + r * each, 1 + (r + 1) * each)
        passes = [mitsuba.gradient(seed, shape) for seed in seeds]
        images = [mitsuba.image(seed)[0] for seed in seeds[:3]]
        values = mitsuba.np.array([g for _, g in passes])
        theirs.append((values.mean(0).tolist(), values.var(0, ddof=1).tolist()))
        row = {"gradient": median([s for s, _ in passes]), "primal": median(images), "ours": []}
        for i, option in enumerate(options):
            mean, variance, seconds = our_gradient(args, option, each, 1_000_000 + r * each)
            mine[i].append((mean, variance))
            row["ours"].append(seconds)
        times.append(row)

    their = pooled(theirs)
    print(f"{'':44} {'variance':>9} {'(geo.)':>8} {'time':>6} {'efficiency':>10} {'(pilots)':>9} {'|z|':>5}")
    for i, option in enumerate(options):
        my = pooled(mine[i])
        total = sum(v for _, v in their) / sum(v for _, v in my)
        logs = [math.log(a[1] / b[1]) for a, b in zip(their, my) if a[1] > 0 and b[1] > 0]
        geometric = math.exp(sum(logs) / len(logs)) if logs else math.nan
        speed = median([t["gradient"] / t["ours"][i]["gradient"] for t in times])
        paid = median([t["gradient"] / (t["ours"][i]["gradient"] + t["ours"][i]["pilots"]) for t in times])
        errors = [math.sqrt((a[1] + b[1]) / repeats) for a, b in zip(their, my)]
        z = max((abs(a[0] - b[0]) / e for a, b, e in zip(their, my, errors) if e > 0), default=0.0)
        found = {
            "arguments": option,
            "variance": total,
            "variance_geometric": geometric,
            "time": speed,
            "efficiency": total * speed,
            "efficiency_with_pilots": total * paid,
            "largest_z": z,
            "our_gradient_over_our_primal": median([t["ours"][i]["gradient"] / t["ours"][i]["primal"] for t in times]),
            "our_primal_over_mitsubas": median([t["ours"][i]["primal"] / t["primal"] for t in times]),
        }
        print(
            f"{option or '(defaults)':44} {total:9.2f} {geometric:8.2f} {speed:6.2f} {total * speed:10.2f} "
            f"{total * paid:9.2f} {z:5.1f}"
        )
        print(
            f"  our gradient takes {found['our_gradient_over_our_primal']:.2f} of our primal, which takes "
            f"{found['our_primal_over_mitsubas']:.2f} of Mitsuba's"
        )
        yield found


def main():
    args = parse()
    options = args.ours or [""]
    mitsuba = Mitsuba(args)
    each = args.repeats // args.rounds
    compare = compare_gradients if args.param else compare_images
    found = list(compare(args, options, mitsuba, each))
    report = {"scene": args.scene, "params": args.param, "spp": args.spp, "passes": each * args.rounds, "ours": found}
    if args.json:
        with open(args.json, "w") as file:
            json.dump(report, file, indent=2)


if __name__ == "__main__":
    main()
