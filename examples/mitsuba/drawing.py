"""Scenes drawn from a seed: a floor and one or two shapes of random materials, textures and places, under one or two lights, seen
by a random camera; and the files that they refer to. Nothing but the standard library is needed."""
import argparse
import math
import os
import random
import shutil
import struct
import zlib

METALS = ["Au", "Cu", "Ag", "Al", "none"]
PLAIN = '<bsdf type="diffuse"/>'


class Draw:
    """Parts of a scene, from a seed."""

    def __init__(self, seed, size=(32, 24)):
        self.random = random.Random(seed)
        self.size = size

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

    def hair(self):
        pigments = lambda: "".join(f'<float name="{name}" value="{self.number(0.05, 1)}"/>' for name in ("eumelanin", "pheomelanin"))
        dye = lambda: self.value("sigma_a") + self.perhaps(0.5, lambda: f'<float name="scale" value="{self.number(0.2, 2)}"/>')
        body = self.perhaps(0.8, pigments if self.chance(0.5) else dye)
        for name, low, high in (("longitudinal_roughness", 0.2, 0.9), ("azimuthal_roughness", 0.2, 0.9), ("scale_tilt", -8, 8), ("int_ior", 1.3, 1.7)):
            body += self.perhaps(0.5, lambda: f'<float name="{name}" value="{self.number(low, high)}"/>')
        return body

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
            "hair": self.hair,
            "null": lambda: "",
        }[kind]()
        return f'<bsdf type="{kind}">{body}</bsdf>'

    def material(self):
        opaque = ("diffuse", "conductor", "roughconductor", "plastic")
        every = (*opaque, "diffuse", "roughconductor", "dielectric", "thindielectric", "roughdielectric", "principled", "hair", "null")
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
        pixels = f'<integer name="width" value="{self.size[0]}"/><integer name="height" value="{self.size[1]}"/>'
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


def write_png(path, width, channels, values):
    """Writes rows of bytes."""
    chunk = lambda tag, data: struct.pack(">I", len(data)) + tag + data + struct.pack(">I", zlib.crc32(tag + data))
    height = len(values) // (width * channels)
    rows = b"".join(b"\0" + bytes(values[y * width * channels : (y + 1) * width * channels]) for y in range(height))
    header = struct.pack(">IIBBBBB", width, height, 8, {1: 0, 3: 2, 4: 6}[channels], 0, 0, 0)
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def write_exr(path, width, values):
    """Writes rows of RGB in single precision."""
    height = len(values) // (3 * width)
    attribute = lambda name, kind, data: f"{name}\0{kind}\0".encode() + struct.pack("<i", len(data)) + data
    channels = b"".join(name + b"\0" + struct.pack("<iBxxxii", 2, 0, 1, 1) for name in (b"B", b"G", b"R")) + b"\0"
    window = struct.pack("<iiii", 0, 0, width - 1, height - 1)
    head = struct.pack("<ii", 20000630, 2) + attribute("channels", "chlist", channels)
    head += attribute("compression", "compression", b"\0") + attribute("dataWindow", "box2i", window)
    head += attribute("displayWindow", "box2i", window) + attribute("lineOrder", "lineOrder", b"\0")
    head += attribute("pixelAspectRatio", "float", struct.pack("<f", 1)) + attribute("screenWindowCenter", "v2f", struct.pack("<ff", 0, 0))
    head += attribute("screenWindowWidth", "float", struct.pack("<f", 1)) + b"\0"
    first, length = len(head) + 8 * height, 8 + 12 * width
    with open(path, "wb") as file:
        file.write(head + b"".join(struct.pack("<Q", first + y * length) for y in range(height)))
        for y in range(height):
            row = values[3 * width * y : 3 * width * (y + 1)]
            file.write(struct.pack("<ii", y, 12 * width) + struct.pack(f"<{3 * width}f", *row[2::3], *row[1::3], *row[0::3]))


def write_mesh(path, corners, faces, with_uv=True, with_normals=True):
    """Writes corners, each a position, a normal and texture coordinates, and triangles, in the format that the name ends in."""
    row = lambda numbers: " ".join(f"{x:.6f}" for x in numbers)
    with open(path, "w") as file:
        if path.endswith(".ply"):
            properties = "".join(f"property float {k}\n" for k in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
            file.write(f"ply\nformat ascii 1.0\nelement vertex {len(corners)}\n{properties}")
            file.write(f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n")
            for p, normal, uv in corners:
                file.write(f"{row(p)} {row(normal)} {row(uv)}\n")
            for face in faces:
                file.write("3 %d %d %d\n" % face)
            return
        for p, normal, uv in corners:
            file.write(f"v {row(p)}\n" + (f"vt {row(uv)}\n" if with_uv else "") + (f"vn {row(normal)}\n" if with_normals else ""))
        for face in faces:
            corner = lambda k: f"{k}" + (f"/{k if with_uv else ''}" if with_uv or with_normals else "") + (f"/{k}" if with_normals else "")
            file.write("f " + " ".join(corner(k + 1) for k in face) + "\n")


def waves(n):
    """Corners and faces of a surface that is not flat."""
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
    return corners, faces


def write_assets(folder):
    """Images and meshes that scenes refer to."""
    values = random.Random(1)
    at = lambda name: os.path.join(folder, name)
    for name, width, height, channels in (("rgb.png", 7, 5, 3), ("grey.png", 4, 6, 1), ("rgba.png", 7, 5, 4)):
        write_png(at(name), width, channels, [values.randrange(256) for _ in range(width * height * channels)])
    slope = lambda: int(255 * (0.5 + 0.25 * (values.random() - 0.5)))
    write_png(at("normal.png"), 8, 3, [x for _ in range(64) for x in (slope(), slope(), 242)])
    write_exr(at("rgb.exr"), 32, [values.random() for _ in range(3 * 32 * 16)])
    for name in ("waves.obj", "waves.ply"):
        write_mesh(at(name), *waves(12))


def parser(doc, tool):
    """Arguments of a script that tries scenes with one of the tools."""
    p = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--seeds", type=int, nargs=2, default=[0, 20], metavar=("FROM", "TO"), help="[default: 0 20]")
    p.add_argument("--spp", type=int, default=128, help="samples per pixel of each run [default: 128]")
    p.add_argument("--binaries", default="target/release", help=f"folder of `{tool}` [default: target/release]")
    p.add_argument("--keep", metavar="FOLDER", help="for the files of scenes that are reported")
    return p


def find(p, args, tool):
    """Where the tool is."""
    path = os.path.abspath(os.path.join(args.binaries, tool))
    if not os.path.exists(path):
        p.error(f"{path}: expected a file, found none")
    return path


def keep(args, folder, names):
    """Copies files of a scene to where they are to be kept, if anywhere."""
    if args.keep:
        os.makedirs(args.keep, exist_ok=True)
        for name in names:
            shutil.copy(os.path.join(folder, name), args.keep)
