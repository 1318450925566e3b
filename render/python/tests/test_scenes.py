"""Scenes, parameters and images."""

import warnings
from pathlib import Path

import numpy as np
import pytest

import render_gradients as rg

WALL, BALL, LAMP = "left.reflectance.value", "sphere.alpha.value", "light.emitter.radiance.value"
SCENE = """<scene version="3.0.0">
  <default name="grey" value="0.5"/>
  <integrator type="path"><integer name="max_depth" value="4"/></integrator>
  <sensor type="perspective"><float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="6"/><integer name="height" value="4"/></film>
  </sensor>
  <bsdf type="diffuse" id="paint"><texture type="bitmap" name="reflectance">
    <string name="filename" value="missing.png"/></texture></bsdf>
  <bsdf type="dielectric" id="glass"/>
  <shape type="rectangle"><ref id="paint"/></shape>
  <shape type="sphere"><float name="radius" value="0.5"/><ref id="glass"/></shape>
  <emitter type="constant" id="sky"><rgb name="radiance" value="$grey"/></emitter>
</scene>"""


def test_parameters_are_arrays_by_name(room: rg.Scene) -> None:
    assert WALL in room and "nothing" not in room
    assert list(room) == room.keys() and len(room) == len(room.keys())
    assert room[WALL].shape == (3,) and room[WALL].dtype == np.float32
    assert room[BALL].shape == () and float(room[BALL]) == pytest.approx(0.2)
    room[WALL] = [0.1, 0.2, 0.3]
    np.testing.assert_array_equal(room[WALL], np.float32([0.1, 0.2, 0.3]))
    room[WALL] = 0.4
    np.testing.assert_array_equal(room[WALL], np.float32([0.4] * 3))
    room[BALL] = np.float64(0.3)
    # A copy: changing it changes nothing.
    room[WALL][:] = 0.0
    assert room[WALL].min() > 0.3
    room.update({WALL: np.ones(3), LAMP: 5})
    assert room[LAMP].max() == 5 and room[WALL].min() == 1
    assert room.info(WALL) == {"shape": (3,), "valid": (0.0, 1.0), "kind": "reflectances"}
    assert room.info(BALL)["shape"] == ()
    assert dict(room).keys() == set(room.keys())
    for (key, value), other in zip(room.items(), room.values(), strict=True):
        np.testing.assert_array_equal(value, room[key])
        np.testing.assert_array_equal(value, other)
    assert [key for key, _ in room.items()] == room.keys()
    np.testing.assert_array_equal(room.get(WALL), room[WALL])
    assert room.get("nothing") is None and room.get("nothing", 3) == 3


def test_mistakes_about_parameters_are_named(room: rg.Scene) -> None:
    with pytest.raises(KeyError, match="no parameter `lift.reflectance`; closest: left.reflectance.value"):
        room["lift.reflectance"]
    with pytest.raises(KeyError, match="`scene.movables\\(\\)` what is one after `scene.make_movable`"):
        room["sphere.translation"]
    with pytest.raises(KeyError, match="closest: sphere.alpha.value"):
        room["spere.alpha.value"] = 0.1
    before = room[WALL]
    np.testing.assert_array_equal(room["left.reflectance"], before)
    with pytest.raises(ValueError, match=r"parameter `left.reflectance.value`: expected an array of shape \(3,\), found \(4,\)"):
        room[WALL] = np.zeros(4)
    with pytest.raises(ValueError, match=r"parameter `left.reflectance.value`\[1\]: expected a value in \[0, 1\], found 2"):
        room[WALL] = [0.0, 2.0, 0.0]
    with pytest.raises(ValueError, match="found NaN"):
        room.update({BALL: 0.3, WALL: np.nan})
    for wrong, found in ((None, "None"), ("red", "text"), (np.ones(3) + 1j, "complex numbers"), ([0.1, None, 0.2], "objects")):
        with pytest.raises(TypeError, match=f"parameter `left.reflectance.value`: expected real numbers, found {found}"):
            room[WALL] = wrong
    with pytest.raises(ValueError, match="parameter `left.reflectance.value`: setting an array element"):
        room[WALL] = [[0.1], [0.2, 0.3]]
    with pytest.raises(KeyError, match="cannot be removed"):
        del room[WALL]
    np.testing.assert_array_equal(room[WALL], before)
    assert float(room[BALL]) == pytest.approx(0.2)


def test_patterns_set_all_that_fits(room: rg.Scene) -> None:
    walls = [key for key in room if key.endswith(".reflectance.value")]
    assert len(walls) > 2
    room["*.reflectance.value"] = 0.25
    assert all((room[key] == 0.25).all() for key in walls)
    # The ending may be left out, and names have the last word over patterns.
    room.update({WALL: 0.5, "*.reflectance": [0.1, 0.2, 0.3], "*.alpha": 0.3, LAMP: 7})
    assert (room[WALL] == 0.5).all() and float(room[BALL]) == np.float32(0.3)
    for key in set(walls) - {WALL}:
        np.testing.assert_array_equal(room[key], np.float32([0.1, 0.2, 0.3]))
    with pytest.raises(KeyError, match="no parameter `\\*.roughness`; closest"):
        room["*.roughness"] = 0.2
    with pytest.raises(ValueError, match=r"parameter `left.reflectance.value`\[0\]: expected a value in \[0, 1\], found 5"):
        room["l*"] = 5.0
    with pytest.raises(KeyError, match="expected the name of one parameter, found the pattern `l\\*` of left.reflectance.value, "):
        room["l*"]
    assert (room[WALL] == 0.5).all()


def test_images_are_functions_of_the_seed(room: rg.Scene) -> None:
    image = room.render()
    assert image.shape == (12, 16, 3) == (*room.size, 3) and image.dtype == np.float32
    assert np.isfinite(image).all() and image.mean() > 0.05
    np.testing.assert_array_equal(image, room.render(spp=16, seed=0))
    assert (image != room.render(seed=1)).any()
    double = room.render(double=True)
    assert double.dtype == np.float64
    np.testing.assert_allclose(double, image, rtol=0.05, atol=0.02)
    # More light, a brighter image, exactly.
    room[LAMP] = 2 * room[LAMP]
    np.testing.assert_allclose(room.render(), 2 * image, rtol=1e-4)


def test_settings_are_attributes(room: rg.Scene) -> None:
    whole = room.render().mean()
    room.max_depth = 1
    assert room.max_depth == 1 and room.render().mean() < 0.7 * whole
    room.max_depth = -1
    assert room.max_depth == -1
    room.sampler, room.lights = "sobol", "all"
    assert (room.sampler, room.lights) == ("sobol", "all")
    with pytest.raises(ValueError, match="sampler: expected one of independent, sobol, antithetic, found `halton`"):
        room.sampler = "halton"
    with pytest.raises(ValueError, match="max_depth: expected -1"):
        room.max_depth = -2
    for wrong in (0, -1, 2**31, 2**70):
        with pytest.raises(ValueError, match="spp: expected 1 to"):
            room.spp = wrong
        with pytest.raises(ValueError, match="spp: expected 1 to"):
            room.render(spp=wrong)
    with pytest.raises(ValueError, match="seed: expected 0 to 18446744073709551615, found -1"):
        room.render(seed=-1)
    with pytest.raises(ValueError, match="sensor: expected 0 to 18446744073709551615, or an id, found -1"):
        room.render(sensor=-1)
    with pytest.raises(ValueError, match="width and height: expected 0 to 4294967295 pixels, found -1"):
        rg.room(-1, 4)
    with pytest.raises(ValueError, match="max_depth: expected -1 for no limit, or at least one edge, found 0"):
        room.max_depth = 0
    with pytest.raises(TypeError):
        room.render(spp="many")
    with pytest.raises(ValueError, match="unknown estimator `miss`; closest: mis; known: emitter, "):
        room.render(estimator="miss")


def test_scene_files_load(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(SCENE)
    with pytest.raises(ValueError, match=r"scene.xml:9: `filename`: expected an existing file .*`missing.png`"):
        rg.load(path)
    with pytest.warns(UserWarning, match="scene.xml:9: .*missing.png"):
        scene = rg.load(str(path), defines={"grey": 0.25}, allow_missing=True)
    assert scene.size == (4, 6) and len(scene.warnings) == 1 and "missing.png" in scene.warnings[0]
    assert scene.files[0] == path
    assert scene["sky.radiance.value"][0] == 0.25
    same = rg.load_string(SCENE, base=tmp_path, defines={"grey": "0.25"}, allow_missing=True)
    np.testing.assert_array_equal(same.render(spp=4), scene.render(spp=4))
    assert repr(scene).startswith("<scene of 4 x 6 pixels, ")


def test_textures_are_arrays_of_rows_and_columns(tmp_path: Path) -> None:
    texels = np.linspace(0.1, 0.9, 2 * 4 * 3, dtype="<f4").reshape(2, 4, 3)
    # A portable float map has the last row first.
    (tmp_path / "paint.pfm").write_bytes(b"PF\n4 2\n-1.0\n" + texels[::-1].tobytes())
    text = SCENE.replace('value="missing.png"/>', 'value="paint.pfm"/><boolean name="raw" value="true"/>')
    scene = rg.load_string(text, base=tmp_path)
    key = "paint.reflectance.data"
    np.testing.assert_array_equal(scene[key], texels)
    scene[key] = 1 - texels
    np.testing.assert_array_equal(scene[key], 1 - texels)
    gradient = scene.backward(np.ones((4, 6, 3)), key, spp=256)[key]
    assert gradient.shape == (2, 4, 3) and (gradient > 0).all()
    with pytest.raises(ValueError, match=r"expected an array of shape \(2, 4, 3\), found \(4, 2, 3\)"):
        scene[key] = np.zeros((4, 2, 3))


def test_mistakes_in_scene_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="nothing.xml: cannot read the file"):
        rg.load(tmp_path / "nothing.xml")
    with pytest.raises((OSError, ValueError)):
        rg.load(tmp_path)
    with pytest.raises(ValueError, match=r":8: .*unknown bsdf `diffus`"):
        rg.load_string(SCENE.replace('"diffuse"', '"diffus"'), allow_missing=True)
    with pytest.raises(ValueError, match="no parameter `gray` to define; known: grey"):
        rg.load_string(SCENE, defines={"gray": 1}, allow_missing=True)
    for width, height in [(0, 1), (2**31, 2**31)]:
        with pytest.raises(ValueError, match="parameter `size`: expected 1 to"):
            rg.room(width, height)
    with pytest.raises(TypeError):
        rg.load(3)


def test_what_may_move_becomes_a_parameter(room: rg.Scene) -> None:
    assert "sphere.translation" in room.movables() and "sphere.translation" not in room
    before = room.render()
    room.make_movable(["sphere.translation", "sensor.fov"])
    assert room["sphere.translation"].shape == (3,) and room.info("sensor.fov")["shape"] == ()
    np.testing.assert_array_equal(room.render(), before)
    room["sphere.translation"] = [0.0, 0.2, 0.0]
    assert (room.render() != before).any()
    adjoint = np.ones((*room.size, 3))
    found = room.backward(adjoint, "sphere.translation", estimator="edges", spp=2)
    assert found["sphere.translation"].shape == (3,) and found["sphere.translation"].any()
    with pytest.raises(KeyError, match="spere.translation"):
        room.make_movable("spere.translation")


def test_matrices_are_read_and_set(room: rg.Scene) -> None:
    scene = rg.load_string(TWICE)
    key = "one.to_world"
    assert key in scene and key not in scene.keys() and "env.to_world" not in scene
    np.testing.assert_array_equal(scene[key], np.eye(4))
    before = scene.render()
    c, s = np.cos(0.5), np.sin(0.5)
    turned = np.array([[1.5 * c, -1.5 * s, 0, 0.5], [1.5 * s, 1.5 * c, 0, 0], [0, 0, 1.5, -0.25], [0, 0, 0, 1]])
    scene[key] = turned
    np.testing.assert_allclose(scene["one.rotation"], [0, 0, 0.5], atol=1e-6)
    np.testing.assert_allclose(scene["one.scale"], 1.5, rtol=1e-6)
    np.testing.assert_allclose(scene[key], turned, atol=1e-6)
    assert (scene.render() != before).any()
    with pytest.raises(ValueError, match=r"`one.to_world`: expected .* mirrors"):
        scene[key] = np.diag([1, -1, 1, 1])
    with pytest.raises(ValueError, match=r"\(4, 4\)"):
        scene[key] = np.ones(16)
    with pytest.raises(ValueError, match="`one.translation`"):
        scene.backward(np.ones((*scene.size, 3)), key, estimator="edges")
    with pytest.raises(KeyError, match="closest: one.to_world"):
        scene["ones.to_world"]
    view = scene["sensor.to_world"]
    view[0, 3] += 0.25
    scene.update({"sensor.to_world": view, "sky.radiance.value": 0.5})
    np.testing.assert_allclose(scene["sensor.translation"], [0.25, 0, 0], atol=1e-6)
    assert "sensor.to_world" in room
    with pytest.raises(ValueError, match="not read from a file"):
        room["sphere.to_world"]


TWICE = """<scene version="3.0.0">
  <sensor type="perspective"><transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="3"/></film></sensor>
  <shape type="rectangle" id="one"/><shape type="rectangle" id="other"/>
  <emitter type="constant" id="sky"/>
</scene>"""


def test_shapes_that_may_cross_are_warned_of_where_edges_are_sampled(tmp_path: Path) -> None:
    path = tmp_path / "twice.xml"
    path.write_text(TWICE)
    scene = rg.load(path)
    scene.make_movable("one.translation")
    adjoint = np.ones((*scene.size, 3))
    expected = "`one` and `other` have faces in the same place"
    with pytest.warns(RuntimeWarning, match=expected):
        scene.backward(adjoint, "one.translation", estimator="edges", spp=1)
    with pytest.warns(RuntimeWarning, match=expected):
        scene.forward("one.translation", estimator="edges", spp=1)
    # Nothing moves, or no edges are sampled.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene.backward(adjoint, "sky.radiance.value", estimator="edges", spp=1)
        scene.backward(adjoint, "one.translation", estimator="interior", spp=1)


VIEWS = """<scene version="3.0.0">
  <sensor type="perspective" id="front"><film type="hdrfilm">
    <integer name="width" value="6"/><integer name="height" value="4"/></film></sensor>
  <sensor type="orthographic" id="side"><film type="hdrfilm">
    <integer name="width" value="2"/><integer name="height" value="3"/></film></sensor>
  <shape type="sphere"><point name="center" x="0" y="0" z="5"/></shape>
  <emitter type="constant"><rgb name="radiance" value="0.5"/></emitter>
</scene>"""


def test_sensors_have_names_and_numbers() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = rg.load_string(VIEWS)
    assert scene.sensors == ["front", "side"] and scene.size == (4, 6)
    for sensor in ("side", 1):
        assert rg.load_string(VIEWS, sensor=sensor).size == (3, 2)
    scene.spp = 5
    own = scene.render(spp=4)
    for sensor in ("side", 1):
        # As the scene that is loaded with that sensor sees it, at its size.
        other = rg.load_string(VIEWS, sensor=sensor)
        assert scene.render(spp=4, seed=3, sensor=sensor).shape == (3, 2, 3)
        np.testing.assert_array_equal(scene.render(spp=4, seed=3, sensor=sensor), other.render(spp=4, seed=3))
        np.testing.assert_array_equal(scene.alpha(spp=4, seed=3, sensor=sensor), other.alpha(spp=4, seed=3))
        key, adjoint = "emitter.radiance.value", np.ones((3, 2, 3))
        found = scene.backward(adjoint, key, spp=4, seed=3, sensor=sensor)
        np.testing.assert_array_equal(found[key], other.backward(adjoint, key, spp=4, seed=3)[key])
        moved = scene.forward(key, spp=4, seed=3, sensor=sensor)
        np.testing.assert_array_equal(moved, other.forward(key, spp=4, seed=3))
        assert scene.check(key, spp=1, repeats=4, sensor=sensor).verdict != "wrong"
        # Of a number of samples of its own, and only for once.
        assert scene.spp == 5 and scene.size == (4, 6)
    np.testing.assert_array_equal(scene.render(spp=4, seed=0, sensor="front"), own)
    np.testing.assert_array_equal(scene.render(spp=4), own)
    value, gradient = rg.value_and_gradient(scene, np.zeros((3, 2, 3)), key, spp=4, sensor="side")
    assert value > 0.0 and gradient[key].any()
    with pytest.raises(ValueError, match="one of `front`, `side`, found `top`"):
        scene.render(spp=4, seed=0, sensor="top")
    assert scene.size == (4, 6)


def test_keys_may_be_patterns(room: rg.Scene) -> None:
    adjoint = np.ones((*room.size, 3))
    walls = ["left.reflectance.value", "right.reflectance.value"]
    some = room.backward(adjoint, walls, spp=2)
    for pattern in ("*t.reflectance.value", "*t.reflectance", ["left.*", "righ?.reflectance"]):
        found = room.backward(adjoint, pattern, spp=2)
        assert sorted(found) == walls, pattern
        np.testing.assert_array_equal(found[walls[0]], some[walls[0]])
    np.testing.assert_array_equal(room.forward("*t.reflectance", spp=2), room.forward(walls, spp=2))
    assert room.refusal("mis", "*.reflectance") is None
    assert sorted(rg.Optimizer(room, "*t.reflectance").keys) == walls
    with pytest.raises(KeyError, match="banana"):
        room.backward(adjoint, "banana*", spp=2)


def test_what_is_covered() -> None:
    scene = rg.load_string(VIEWS)
    np.testing.assert_array_equal(scene.alpha(spp=4), np.ones((4, 6), np.float32))
    scene.hide_emitters = True
    assert scene.hide_emitters
    image, alpha = scene.render(spp=512), scene.alpha(spp=512)
    assert 0 < alpha.mean() < 1 and alpha.shape == (4, 6)
    # Half of the light of the sky comes back, and nothing but that is seen.
    np.testing.assert_allclose(image[..., 0], 0.25 * alpha, atol=0.02)


def test_scenes_are_saved(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text(VIEWS)
    scene = rg.load(tmp_path / "scene.xml")
    key = next(k for k in scene.keys() if k.endswith("radiance.value"))
    scene[key] = 0.75
    files = scene.save(tmp_path / "new" / "scene.xml")
    assert files[-1] == tmp_path / "new" / "scene.xml"
    np.testing.assert_array_equal(rg.load(files[-1])[key], np.float32([0.75] * 3))
