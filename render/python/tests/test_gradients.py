"""Gradients, derivative images, losses and optimisers."""

import numpy as np
import pytest

import render_gradients as rg

#: A plate of rough metal that mirrors a ball light.
PLATE = """<scene version="3.0.0">
  <integrator type="path"><integer name="max_depth" value="2"/></integrator>
  <sensor type="perspective"><float name="fov" value="24"/>
    <transform name="to_world"><lookat origin="0, 2.2, 3.6" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/></film></sensor>
  <bsdf type="roughconductor" id="metal"><float name="alpha" value="0.2"/></bsdf>
  <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/></transform><ref id="metal"/></shape>
  <shape type="sphere"><point name="center" value="-0.6, 2, -3.2"/><float name="radius" value="0.6"/>
    <emitter type="area"><rgb name="radiance" value="4, 3, 2"/></emitter></shape>
</scene>"""
METAL = "metal.alpha.value"
WALL, BALL, LAMP = "left.reflectance.value", "sphere.alpha.value", "light.emitter.radiance.value"


def test_reverse_mode_is_the_transpose_of_forward_mode(room: rg.Scene) -> None:
    adjoint = np.random.default_rng(1).normal(size=(*room.size, 3)).astype(np.float32)
    room.max_depth = 4  # without roulette both see the same paths
    gradient = room.backward(adjoint, [WALL, BALL], seed=3)
    assert gradient[WALL].shape == (3,) and gradient[WALL].dtype == np.float64
    assert gradient[BALL].shape == ()
    twice = room.backward(adjoint, [BALL, WALL, BALL], seed=3)
    assert list(twice) == [BALL, WALL] and twice[BALL] == gradient[BALL]
    by_wall, by_ball = room.forward(WALL, seed=3), room.forward({BALL: 1}, seed=3)
    assert by_wall.shape == adjoint.shape
    along = (adjoint * by_wall).sum(axis=(0, 1))
    np.testing.assert_allclose(gradient[WALL], along, rtol=1e-3, atol=1e-3 * abs(along).max())
    np.testing.assert_allclose(gradient[BALL], (adjoint * by_ball).sum(), rtol=1e-3)
    both = room.forward({WALL: [1, 2, 3], BALL: 0.5}, seed=3)
    np.testing.assert_allclose(both, by_wall * [1, 2, 3] + 0.5 * by_ball, rtol=1e-3, atol=1e-4)


def test_emission_is_linear(room: rg.Scene) -> None:
    image = room.render(seed=1)
    np.testing.assert_allclose(room.forward(LAMP) * room[LAMP], image, rtol=1e-3, atol=1e-4)


def test_every_estimator_is_named_with_what_it_refuses(room: rg.Scene) -> None:
    known = rg.estimators()
    assert {"mis", "detached", "attached", "differential"} <= {e.name for e in known}
    for e in known:
        assert e.summary and e.capabilities and e.refuses and e.name in repr(e)
        assert e.biased == ("biased" in e.capabilities)
    assert room.refusal("mis", WALL) is None
    assert "discontinuities" in room.refusal("attached")
    adjoint = np.ones((*room.size, 3))
    with pytest.raises(ValueError, match="discontinuities"):
        room.backward(adjoint, WALL, estimator="attached")
    with pytest.raises(ValueError, match="discontinuities"):
        room.forward(WALL, estimator="attached")
    assert room.backward(adjoint, WALL, estimator="auto")[WALL].shape == (3,)
    with pytest.raises(ValueError, match="unknown estimator `miss`; closest: mis; known: auto, emitter"):
        room.backward(adjoint, WALL, estimator="miss")
    glass = rg.load_string(
        """<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/>
        <film type="hdrfilm"><integer name="width" value="2"/><integer name="height" value="2"/></film></sensor>
        <bsdf type="dielectric" id="glass"/><shape type="sphere"><ref id="glass"/></shape>
        <emitter type="constant"/></scene>"""
    )
    eta = next(k for k in glass if glass.info(k)["kind"] == "Dirac deltas")
    with pytest.raises(ValueError, match=f"parameter `{eta}` moves a Dirac delta"):
        glass.backward(np.ones((2, 2, 3)), eta)
    # Without keys: what the estimator sees.
    assert eta not in glass.backward(np.ones((2, 2, 3)), spp=1)


def test_adjoints_are_looked_at(room: rg.Scene) -> None:
    with pytest.raises(ValueError, match=r"adjoint: expected an array of shape \(12, 16, 3\), found \(16, 12, 3\)"):
        room.backward(np.ones((16, 12, 3)), WALL)
    adjoint = np.ones((12, 16, 3))
    adjoint[2, 5, 1] = np.inf
    with pytest.raises(ValueError, match="found inf in row 2, column 5, channel 1"):
        room.backward(adjoint, WALL)
    with pytest.raises(TypeError, match="expected real numbers, found complex numbers"):
        room.backward(1j * np.ones((12, 16, 3)), WALL)
    with pytest.raises(TypeError, match="expected real numbers, found None"):
        rg.loss(None, None)
    with pytest.raises(TypeError, match="direction of `left.reflectance.value`: expected real numbers, found text"):
        room.forward({WALL: "red"})
    with pytest.raises(KeyError, match="the pattern `l\\*` of left.reflectance.value, light"):
        room.forward({"l*": 1.0})
    with pytest.raises(ValueError, match="keys: expected at least one"):
        room.backward(np.ones((12, 16, 3)), [])
    with pytest.raises(KeyError, match="closest"):
        room.backward(np.ones((12, 16, 3)), ["left"])
    with pytest.raises(TypeError):
        room.backward(np.ones((12, 16, 3)), 3)
    # Other layouts in memory are understood.
    turned = np.asfortranarray(np.random.default_rng(1).normal(size=(12, 16, 3)))
    np.testing.assert_array_equal(
        room.backward(turned, WALL)[WALL], room.backward(np.ascontiguousarray(turned), WALL)[WALL]
    )


def test_losses() -> None:
    value, adjoint = rg.loss([1.0, 2.0], [0.0, 0.0])
    assert value == 2.5 and adjoint.tolist() == [1.0, 2.0]
    assert rg.loss(np.ones((2, 2, 3)), np.ones((2, 2, 3)), "relative-l1")[0] == 0.0
    with pytest.raises(ValueError, match="loss: expected one of l1, l2"):
        rg.loss([1.0], [1.0], "l3")
    with pytest.raises(ValueError, match=r"target: expected an array of shape \(2,\), found \(3,\)"):
        rg.loss(np.ones(2), np.ones(3))
    with pytest.raises(ValueError, match="expected a finite value, found NaN"):
        rg.loss([np.nan], [1.0])


def test_a_colour_and_a_roughness_are_recovered() -> None:
    scene = rg.room(24, 24)
    target = scene.render(spp=256, seed=1000)
    truth = {k: scene[k] for k in (WALL, BALL)}
    scene.update({WALL: 0.5, BALL: 0.4})
    optimizer = rg.Optimizer(scene, [WALL, BALL], rate=0.05, rates={BALL: 0.1})
    assert optimizer.keys == [WALL, BALL]
    first, values = None, []
    for step in range(80):
        value, gradient = rg.value_and_gradient(scene, target, optimizer.keys, spp=16, seed=step)
        optimizer.step(gradient)
        first = value if first is None else first
        values.append(np.append(scene[WALL], scene[BALL]))
    assert optimizer.steps == 80 and value < first
    found = np.mean(values[-20:], axis=0)
    np.testing.assert_allclose(found[:3], truth[WALL], atol=0.06)
    np.testing.assert_allclose(found[3], truth[BALL], atol=0.08)


def test_optimizers_leave_things_alone_where_they_fail(room: rg.Scene) -> None:
    optimizer = rg.Optimizer(room, WALL, method="sgd")
    before = room[WALL]
    with pytest.raises(ValueError, match="gradient: expected an array for `left.reflectance.value`, found none"):
        optimizer.step({})
    with pytest.raises(ValueError, match="expected a finite value, found NaN"):
        optimizer.step({WALL: np.full(3, np.nan)})
    with pytest.raises(ValueError, match="expected arrays for left.reflectance.value, found some for sphere.alpha.value, typo, too"):
        optimizer.step({WALL: np.ones(3), "typo": np.ones(3), BALL: 1.0})
    with pytest.raises(TypeError, match="gradient of `left.reflectance.value`: expected real numbers, found None"):
        optimizer.step({WALL: None})
    assert optimizer.steps == 0
    np.testing.assert_array_equal(room[WALL], before)
    # Far beyond the bounds, and back at them.
    optimizer.step({WALL: np.full(3, -1e6)})
    np.testing.assert_array_equal(room[WALL], np.ones(3))
    with pytest.raises(ValueError, match="optimizer: expected one of sgd, adam|optimizer: expected one of adam, sgd"):
        rg.Optimizer(room, WALL, method="newton")
    with pytest.raises(ValueError, match="rate"):
        rg.Optimizer(room, WALL, rate=-1.0)


def test_a_gradient_is_checked(room: rg.Scene) -> None:
    room.max_depth = 3
    report = room.check([WALL, LAMP], spp=32, repeats=8, tolerance=0.5)
    assert report.verdict == "right" and report, str(report)
    rows = report.params[WALL]
    assert len(rows) == 3 and rows[0]["along"] == "[0]" and rows[0]["resolution"] < 0.5
    assert all(abs(r["z"]) < report.z_limit for r in rows)
    assert "right (limit of |z|" in str(report) and repr(report).startswith("<check: right; left")
    assert list(room.check([LAMP, LAMP], spp=1, repeats=4).params) == [LAMP]
    vague = room.check(WALL, spp=1, repeats=4, tolerance=0.01)
    assert vague.verdict == "cannot tell" and not vague
    with pytest.raises(ValueError, match="repeats: expected at least four, found 2"):
        room.check(WALL, repeats=2)


def test_estimators_are_compared() -> None:
    plate = rg.load_string(PLATE)
    parts: list[float] = []
    names = ["mis", "attached", "attached-naive"]
    rows = rg.compare(plate, METAL, names, spp=32, repeats=8, progress=parts.append)
    assert [r.finding for r in rows] == ["right", "refused", "biased"], rows
    assert "discontinuities" in rows[1].refused and rows[1].efficiency == 0.0
    assert rows[0].efficiency > 0.0 and rows[0].std_error > 0.0
    assert [len(r.ladder) for r in rows] == [4, 0, 4]
    assert parts == sorted(parts) and parts[-1] == pytest.approx(1.0)
    # What is found depends on the seed alone, not on the company.
    alone = rg.compare(plate, METAL, "attached-naive", spp=32, repeats=8)[0]
    assert alone.mean == rows[2].mean
    with pytest.raises(ValueError, match="repeats: expected at least 4"):
        rg.compare(plate, METAL, repeats=3)
    with pytest.raises(ValueError, match="reference: "):
        rg.compare(plate, METAL, reference="attached")


def test_a_biased_estimator_is_called_wrong() -> None:
    plate = rg.load_string(PLATE)
    assert plate.check(METAL, estimator="attached-naive", spp=32, repeats=8).verdict == "wrong"
