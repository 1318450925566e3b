"""Image files."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

import render_gradients as rg


def png(rows: np.ndarray) -> bytes:
    """A PNG file of bytes, height x width x 3."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width, _ = rows.shape
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = zlib.compress(b"".join(b"\0" + row.tobytes() for row in rows))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def test_every_bit_comes_back_from_openexr(tmp_path: Path, room: rg.Scene) -> None:
    image = room.render(spp=2)
    rg.write_image(tmp_path / "room.exr", image)
    found = rg.read_image(tmp_path / "room.exr")
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, image)
    # Derivatives are negative in places, and in double precision where they are sums.
    rg.write_image(str(tmp_path / "grey.EXR"), np.array([[-1.5, 0.25, 3e9]]))
    np.testing.assert_array_equal(rg.read_image(tmp_path / "grey.EXR"), np.float32([[[-1.5] * 3, [0.25] * 3, [3e9] * 3]]))
    # A target for a recovery, as the tools write it.
    assert rg.loss(image, found)[0] == 0.0


def test_pictures_are_decoded_from_srgb(tmp_path: Path) -> None:
    path = tmp_path / "three.png"
    path.write_bytes(png(np.uint8([[[0, 128, 255], [10, 20, 30]]])))
    linear = lambda x: np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)  # noqa: E731
    bytes_ = np.float64([[[0, 128, 255], [10, 20, 30]]]) / 255
    np.testing.assert_allclose(rg.read_image(path), linear(bytes_), rtol=1e-6)
    np.testing.assert_allclose(rg.read_image(path, raw=True), bytes_, rtol=1e-6)
    # There and back; a stop is a factor of two.
    rg.write_image(tmp_path / "again.png", rg.read_image(path))
    np.testing.assert_array_equal(rg.read_image(tmp_path / "again.png"), rg.read_image(path))
    rg.write_image(tmp_path / "darker.png", np.full((2, 3, 3), 0.5), stops=-1)
    np.testing.assert_allclose(rg.read_image(tmp_path / "darker.png"), 0.25, atol=0.005)


def test_mistakes_about_images_are_named(tmp_path: Path) -> None:
    image = np.full((2, 3, 3), 0.5)
    with pytest.raises(FileNotFoundError, match="nothing.exr: cannot read the file"):
        rg.read_image(tmp_path / "nothing.exr")
    (tmp_path / "text.exr").write_text("no image")
    with pytest.raises(ValueError, match="text.exr: expected an OpenEXR, .* found a file that starts with bytes"):
        rg.read_image(tmp_path / "text.exr")
    with pytest.raises(ValueError, match="expected a name that ends in `.exr` or `.png`, found `.*image.jpg`"):
        rg.write_image(tmp_path / "image.jpg", image)
    for shape in ((3,), (2, 3, 4), (1, 2, 3, 3)):
        with pytest.raises(ValueError, match=r"image: expected an array of shape \(height, width, 3\) or \(height, width\), found"):
            rg.write_image(tmp_path / "image.exr", np.zeros(shape))
    with pytest.raises(ValueError, match="from 1 to 65536 rows and columns"):
        rg.write_image(tmp_path / "image.exr", np.zeros((0, 3, 3)))
    for name in ("image.exr", "image.png"):
        image[1, 2, 0] = np.nan
        with pytest.raises(ValueError, match="image: expected finite numbers, found NaN in row 1, column 2, channel 0"):
            rg.write_image(tmp_path / name, image)
    with pytest.raises(ValueError, match="image: expected finite numbers, found inf in row 0, column 1"):
        rg.write_image(tmp_path / "image.exr", [[0.0, np.inf]])
    image[:] = 0.5
    with pytest.raises(ValueError, match="stops: expected none for an OpenEXR file"):
        rg.write_image(tmp_path / "image.exr", image, stops=1)
    with pytest.raises(ValueError, match="stops: expected a finite number, found NaN"):
        rg.write_image(tmp_path / "image.png", image, stops=np.nan)
    with pytest.raises(TypeError, match="expected real numbers, found text"):
        rg.write_image(tmp_path / "image.png", "image")
    with pytest.raises(OSError):
        rg.write_image(tmp_path / "no" / "such" / "folder.png", image)
    assert sorted(f.name for f in tmp_path.iterdir()) == ["text.exr"]


def test_layers_have_names(tmp_path: Path, room: rg.Scene) -> None:
    rg.write_image(tmp_path / "one.exr", room.render(spp=1))
    with pytest.raises(ValueError, match="one.exr: expected .*`Combined`"):
        rg.read_image(tmp_path / "one.exr", layer="Combined")
