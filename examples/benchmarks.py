#!/usr/bin/env python3
"""Measures times with fixed commands, and rewrites the tables of docs/benchmarks.md and the times of docs/figures.md.

  cargo build --release
  examples/benchmarks.py                     every table that can be measured without other renderers
  examples/benchmarks.py passes samples      these tables
  examples/benchmarks.py figures             times of docs/figures.md, from out/*/manifest.json of earlier runs
  examples/benchmarks.py instructions --binaries target/portable/release
                                             instructions of a sample, by valgrind, and by how much they have changed
  examples/benchmarks.py mitsuba             against Mitsuba 3 (pip install mitsuba numpy)

A table stands between `<!-- NAME -->` and `<!-- end NAME -->` and is replaced as a whole, with the date and the
machine that it was measured on; what is not measured keeps its numbers. Commands that are compared run in turns, and
a number is the median over the rounds. Leave the machine alone meanwhile.

Instructions need a build that valgrind knows the instructions of. Their counts are those of any machine:

  RUSTFLAGS="-C target-cpu=x86-64-v3" cargo build --release --target-dir target/portable --bin render --bin gradient
"""
import argparse
import datetime
import glob
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..")
CORNELL = ("examples/scenes/cornell.xml", ["red.reflectance.value", "green.reflectance.value", "white.reflectance.value"])
# Names of parameters in both, or that of Mitsuba and ours.
SCENES = {
    "glass": ["frosted.alpha.value"],
    "plastics": ["green.alpha=green.alpha.value", "both.brdf_0.alpha=lacquer.alpha.value"],
    "cards": ["red.reflectance.value", "copper.alpha.value"],
    "relief": ["gold_relief.nested_bsdf.alpha.value=gold.alpha.value", "red_relief.nested_bsdf.diffuse_reflectance.value=red.diffuse_reflectance.value"],
    "principled": ["lacquer.base_color.value", "soft.base_color.value"],
    "brushed": ["gold.alpha.value"],
    "lamps": ["grey.reflectance.value"],
    "mirrors": ["copper.alpha.value"],
}
BOXES = ("examples/scenes/metal-boxes.xml", ["gold.alpha.value", "copper.alpha.value"])
ESTIMATORS = ["detached", "mis", "mis-balance", "mis-attached-weights", "attached-naive", "reparameterised",
              "reparameterised-mis", "differential", "differential-mis"]


def fail(message):
    sys.exit(f"benchmarks: {message}")


def median(values):
    values = sorted(values)
    half = len(values) // 2
    return values[half] if len(values) % 2 else 0.5 * (values[half - 1] + values[half])


def run(command):
    """What a command printed."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    except OSError as error:
        fail(f"{command[0]}: {error}; expected `cargo build --release` before")
    if done.returncode != 0:
        fail(f"{' '.join(command)}\n{done.stderr.strip()}")
    return done.stdout


def machine():
    """The processor and how many of its threads may be used."""
    name = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo") as file:
            name = next((l.split(":", 1)[1].strip() for l in file if l.startswith("model name")), name)
    except OSError:
        pass
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{name}, {threads} threads"


def table(head, rows):
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return lines + ["| " + " | ".join(row) + " |" for row in rows]


def write(path, text):
    """Beside its name, then renamed: never half a page."""
    with open(path + ".new", "w") as file:
        file.write(text)
    os.replace(path + ".new", path)


def put(name, rows):
    """Replaces a table of docs/benchmarks.md."""
    path = os.path.join(ROOT, "docs", "benchmarks.md")
    with open(path) as file:
        page = file.read()
    block = re.compile(rf"<!-- {name} -->\n.*?<!-- end {name} -->", re.S)
    if not block.search(page):
        fail(f"{path}: expected <!-- {name} --> and <!-- end {name} -->, found none")
    today = datetime.date.today().isoformat()
    note = f"Measured on {today} ({machine()}) by `examples/benchmarks.py {name}`."
    new = "\n".join([f"<!-- {name} -->", note, "", *rows, f"<!-- end {name} -->"])
    write(path, block.sub(lambda _: new, page))
    print("\n".join([note, *rows]))


def numbers_of(name):
    """What the last column of a table of docs/benchmarks.md says of its rows."""
    with open(os.path.join(ROOT, "docs", "benchmarks.md")) as file:
        page = file.read()
    found = page.split(f"<!-- {name} -->")[1].split(f"<!-- end {name} -->")[0]
    rows = [line.strip("| ").split(" | ") for line in found.splitlines() if line.startswith("| ")]
    return {row[0]: float(row[-1]) for row in rows if re.fullmatch(r"[0-9.]+", row[-1])}


def tool(args, name):
    return os.path.join(args.binaries, name)


def seconds_of_gradient(args, scene, params, options, seed, json_file):
    """Seconds of an image and of a gradient pass."""
    command = [tool(args, "gradient"), scene, "--json", json_file, "--seed", str(seed), "--spp", str(args.spp)]
    command += ["--repeats", "2", "-D", f"res={args.res}", *options]
    for key in params:
        command += ["--param", key]
    run(command)
    with open(json_file) as file:
        report = json.load(file)
    return report["seconds_primal"], report["seconds_gradient"]


def passes(args):
    """An image, and a gradient over it."""
    cases = [("Cornell box, nine albedos", *CORNELL), ("metal boxes, two roughnesses", *BOXES)]
    times = [[] for _ in cases]
    with tempfile.TemporaryDirectory() as folder:
        for r in range(args.rounds):
            for found, (_, scene, params) in zip(times, cases):
                found.append(seconds_of_gradient(args, scene, params, [], r, os.path.join(folder, "out.json")))
    rows = []
    for (name, _, _), found in zip(cases, times):
        primal, ratio = median([p for p, _ in found]), median([g / p for p, g in found])
        rows.append([name, f"{primal:.3f} s", f"{ratio:.2f}"])
    head = [f"{args.res} x {args.res}, {args.spp} samples per pixel, `mis`", "image", "gradient over image"]
    put("passes", table(head, rows))


def samples(args):
    """What a gradient pass takes by each estimator, over `detached`."""
    scene, params = BOXES
    times = {name: [] for name in ESTIMATORS}
    with tempfile.TemporaryDirectory() as folder:
        for r in range(args.rounds):
            for name in ESTIMATORS:
                report = os.path.join(folder, "out.json")
                found = seconds_of_gradient(args, scene, params, ["--estimator", name], r, report)
                times[name].append(found[1])
    rows = []
    for name in ESTIMATORS:
        ratio = median([t / d for t, d in zip(times[name], times["detached"])])
        rows.append([f"`{name}`", f"{ratio:.2f}"])
    put("samples", table(["estimator, two roughnesses of the metal boxes", "time over that of `detached`"], rows))


def refs(command):
    """How many instructions a command takes."""
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "out")
        run(["valgrind", "--tool=cachegrind", "--cache-sim=no", f"--cachegrind-out-file={out}", *command])
        with open(out) as file:
            return next(int(l.split()[1]) for l in file if l.startswith("summary:"))


def instructions(args):
    """Instructions of a sample on one thread. What starting takes is left out: the difference of two runs."""
    size, spp = 32, (4, 12)
    rows = []
    for name, scene, params in [("Cornell box, nine albedos", *CORNELL), ("metal boxes, two roughnesses", *BOXES)]:
        with tempfile.TemporaryDirectory() as folder:
            common = [scene, "-D", f"res={size}", "--threads", "1"]
            image = [tool(args, "render"), *common, "-o", os.path.join(folder, "out.exr")]
            gradient = [tool(args, "gradient"), *common, "--repeats", "2", "--json", os.path.join(folder, "out.json")]
            gradient += [f"--param={key}" for key in params]
            for what, passes, command in [("image", 1, image), ("image and gradient", 2, gradient)]:
                few, many = (refs([*command, "--spp", str(n)]) for n in spp)
                each = (many - few) / (size * size * (spp[1] - spp[0]) * passes)
                rows.append([f"{name}, {what}", f"{each:.0f}"])
    before = numbers_of("instructions")
    for name, now in rows:
        if name in before:
            print(f"{name}: {float(now) / before[name]:.4f} of what the page says")
    put("instructions", table(["with `mis`", "instructions of a sample"], rows))


def recover(args):
    """The main job, from start to end."""
    rows = []
    for options in [[], ["--optimizer", "gauss-newton"]]:
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            run([tool(args, "recover"), *options, "--out", os.path.join(folder, "recover")])
            rows.append([f"`{' '.join(['recover', *options])}`", f"{time.perf_counter() - start:.0f} s"])
    put("recover", table(["command", "wall clock"], rows))


def automatic_differentiation(args):
    """The table that `cargo bench -p ad-core` prints."""
    rows, title = [], None
    for line in run(["cargo", "bench", "--locked", "-p", "ad-core", "--bench", "derivatives"]).splitlines():
        head = re.match(r"(\S.*?)\s+ns\s+ratio\s+bar$", line)
        found = re.match(r"(\S.*?)\s+(\d+\.\d+)\s+(\d+\.\d+)(?:\s+(\d+\.\d+)\s+\w+)?\s*$", line)
        if head:
            title = head.group(1)
        elif found and title:
            rows.append([f"{title}: {found.group(1)}", found.group(2), found.group(3), found.group(4) or ""])
    if not rows:
        fail("cargo bench -p ad-core: expected a table of ratios, found none")
    put("ad", table(["", "ns", "ratio", "largest ratio allowed"], rows))


def mitsuba(args):
    """Images and gradients against Mitsuba 3, on the scenes of the repository."""
    script = os.path.join(ROOT, "examples", "mitsuba", "against_mitsuba.py")
    jobs = [
        ("Cornell box, image", CORNELL[0], [], ["", "--sampler independent"]),
        ("Cornell box, nine albedos", *CORNELL, ["", "--sampler independent"]),
        ("metal boxes, two roughnesses", *BOXES, ["--estimator mis-balance", "--estimator differential-mis --caustics particles"]),
    ]
    for scene, params in SCENES.items():
        path = f"examples/scenes/{scene}.xml"
        names = ", ".join(key.split("=")[-1] for key in params)
        jobs += [(f"{scene}, image", path, [], [""]), (f"{scene}, {names}", path, params, [""])]
    rows = []
    for name, scene, params, ours in jobs:
        with tempfile.TemporaryDirectory() as folder:
            out = os.path.join(folder, "out.json")
            command = [sys.executable, script, scene, "--json", out, "--spp", str(args.spp), "--binaries", args.binaries]
            command += ["-D", f"res={args.res}"] + [f"--ours={o}" for o in ours]
            for key in params:
                command += ["--param", key]
            run(command)
            with open(out) as file:
                report = json.load(file)
        for found in report["ours"]:
            numbers = [f"{found[k]:.2g}" for k in ("variance", "time", "efficiency")]
            rows.append([name, f"`{found['arguments']}`" if found["arguments"] else "", *numbers])
    put("mitsuba", table(["", "options", "variance", "time", "efficiency"], rows))


def figures(args):
    """Times of figures, from the manifests that they have left."""
    path = os.path.join(ROOT, "docs", "figures.md")
    with open(path) as file:
        lines = file.read().splitlines()
    found = {}
    for name in glob.glob(os.path.join(args.out, "*", "manifest.json")):
        with open(name) as file:
            manifest = json.load(file)
        if manifest["seconds"] > 0 and not manifest["errors"]:
            found[manifest["figure"]] = (manifest["seconds"], manifest["quick"])
    if not found:
        fail(f"{args.out}: expected folders with manifest.json, found none; run a figure before")
    changed = 0
    for i, line in enumerate(lines):
        cells = line.split(" | ")
        name = cells[0].removeprefix("| ").strip("`")
        if line.startswith("| `") and name in found and len(cells) == 5:
            seconds, quick = found[name]
            taken = f"{seconds:.2g} s" if seconds < 100 else f"{seconds / 60:.0f} min"
            cells[3] = taken + (" (quick)" if quick else "")
            lines[i] = " | ".join(cells)
            changed += 1
    today = datetime.date.today().isoformat()
    note = f"Times: the last run of each, as of {today} ({machine()})."
    text = re.sub(r"Times: .*", lambda _: note, "\n".join(lines) + "\n", count=1)
    write(path, text)
    print(f"{path}: {changed} times")


TABLES = {
    "passes": passes,
    "samples": samples,
    "instructions": instructions,
    "recover": recover,
    "ad": automatic_differentiation,
    "mitsuba": mitsuba,
    "figures": figures,
}


# Tables that need more than this repository as it is built.
ASKED_FOR = ("instructions", "mitsuba", "figures")


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("tables", nargs="*", metavar="TABLE", help=f"of {', '.join(TABLES)} [default: all but {', '.join(ASKED_FOR)}]")
    p.add_argument("--rounds", type=int, default=7, help="turns that commands take [default: 7]")
    p.add_argument("--spp", type=int, default=64, help="samples per pixel [default: 64]")
    p.add_argument("--res", type=int, default=256, help="side of images, in pixels [default: 256]")
    p.add_argument("--binaries", default=os.path.join(ROOT, "target", "release"), help="folder of the tools")
    p.add_argument("--out", default=os.path.join(ROOT, "out"), help="folder of the figures")
    args = p.parse_args()
    args.binaries = os.path.abspath(args.binaries)
    unknown = [t for t in args.tables if t not in TABLES]
    if unknown:
        p.error(f"{unknown[0]}: expected one of {', '.join(TABLES)}")
    if args.rounds < 1:
        p.error("--rounds: expected at least one")
    for name in args.tables or [t for t in TABLES if t not in ASKED_FOR]:
        TABLES[name](args)


if __name__ == "__main__":
    main()
