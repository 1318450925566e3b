//! Things that move above a floor, below a lamp: scenes, gradients in double precision, differences.

use ad_core::Dual;
use render::estimator::Unbiased;
use render::instances::{Estimator, render_f64};
use render::integrator::gradient::{Active, backward};
use render::integrator::render::render;
use render::params::{Tangent, Theta};
use render::sampler::Independent;
use render::statistics::{Estimate, z_limit};
use render::{Job, Scene, Settings};

use crate::{mean_adjoint, values};

/// The corners of an octahedron.
pub const CORNERS: [[i32; 3]; 6] = [
    [1, 0, 0],
    [-1, 0, 0],
    [0, 1, 0],
    [0, -1, 0],
    [0, 0, 1],
    [0, 0, -1],
];

/// Its faces, whose corners are counted from one.
pub const FACES: [[usize; 3]; 8] = [
    [1, 3, 5],
    [3, 2, 5],
    [2, 4, 5],
    [4, 1, 5],
    [3, 1, 6],
    [2, 3, 6],
    [4, 2, 6],
    [1, 4, 6],
];

/// That as an OBJ file, with nothing else.
pub fn octahedron() -> String {
    let corners = CORNERS.map(|[x, y, z]| format!("v {x} {y} {z}\n"));
    let faces = FACES.map(|[a, b, c]| format!("f {a} {b} {c}\n"));
    corners.concat() + &faces.concat()
}

/// Derivatives of the mean of all pixels and channels in double precision, from `runs` seeds.
pub fn gradient<E: Unbiased>(s: &Scene, names: &[&str], runs: u64, spp: u64) -> Vec<Estimate> {
    let all = values::<f64>(s);
    let theta = Theta::constant(&all);
    let active = Active::seen_by::<E, _>(s, names).expect("seen");
    let adjoint = mean_adjoint(s);
    let runs: Vec<Vec<f64>> = (0..runs)
        .map(|seed| {
            let job = Job::new(s, &s.settings, seed, 0..spp, &());
            let g = backward::<f64, E, Independent>(&job, &theta, &active, &adjoint);
            let g = g.expect("admitted");
            assert_eq!(g.non_finite.count, 0);
            g.values.concat()
        })
        .collect();
    estimates(&runs)
}

fn estimates(runs: &[Vec<f64>]) -> Vec<Estimate> {
    (0..runs[0].len())
        .map(|i| Estimate::of(&runs.iter().map(|r| r[i]).collect::<Vec<_>>()))
        .collect()
}

/// Mean of all pixels and channels.
pub fn mean(s: &Scene, settings: &Settings, seed: u64, spp: u64) -> f64 {
    let all = values::<f64>(s);
    let job = Job::new(s, settings, seed, 0..spp, &());
    let r = render_f64(&job, &Theta::constant(&all), Estimator::Mis);
    r.mean(0).iter().sum::<f64>() / 3.0
}

/// Central differences in every element of the named ranges, from `runs` seeds.
pub fn differences(s: &mut Scene, names: &[&str], h: f32, runs: u64, spp: u64) -> Vec<Estimate> {
    let range = |name: &&str| s.params().find(name).expect("known").range();
    let elements: Vec<usize> = names.iter().flat_map(range).collect();
    differences_in(s, &elements, h, runs, spp)
}

/// The same in some elements of the vector of parameters.
pub fn differences_in(
    s: &mut Scene,
    elements: &[usize],
    h: f32,
    runs: u64,
    spp: u64,
) -> Vec<Estimate> {
    let start = s.params().values().to_vec();
    let settings = s.settings;
    let mut out = Vec::new();
    for &i in elements {
        let mut at = |by: f32, seed: u64| {
            let mut values = start.clone();
            values[i] += by;
            s.set_params(&values).expect("valid");
            mean(s, &settings, 1000 + seed, spp)
        };
        let found: Vec<f64> = (0..runs)
            .map(|seed| (at(h, seed) - at(-h, seed)) / (2.0 * f64::from(h)))
            .collect();
        out.push(Estimate::of(&found));
    }
    s.set_params(&start).expect("valid");
    out
}

/// Asserts that a gradient is another one, of which `bias` times the largest is allowed for the step or for a kernel.
///
/// # Panics
/// If it is not, or says nothing.
pub fn agrees(what: &str, found: &[Estimate], expected: &[Estimate], bias: f64, runs: u64) {
    let size = expected.iter().fold(0.0, |m: f64, e| m.max(e.mean.abs()));
    let limit = z_limit(found.len(), runs, 1e-3);
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        println!(
            "{what} {i}: {:+.6} +- {:.6}, expected {:+.6} +- {:.6}",
            a.mean, a.se, b.mean, b.se
        );
    }
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        let off = (a.mean - b.mean).abs() - bias * size;
        assert!(
            off <= limit * a.se.hypot(b.se),
            "{what} {i}: {a:?}, not {b:?}"
        );
        assert!(
            a.se.hypot(b.se) < 0.15 * size,
            "{what} {i}: {a:?} {b:?} say nothing"
        );
    }
}

/// A derivative by both modes.
pub struct BothModes {
    /// The parameter, and which of its numbers.
    pub what: String,
    /// By forward mode.
    pub pushed: f64,
    /// By reverse mode.
    pub pulled: f64,
    /// The sum of all absolute values that it is the sum of in forward mode: rounding is a part of that.
    pub size: f64,
}

/// The derivatives of `<adjoint, image>` in all numbers of these parameters, by forward and by reverse mode at one seed, in
/// double precision: 2 samples per pixel, an adjoint of both signs.
pub fn both_modes<E: Unbiased>(s: &Scene, names: &[&str]) -> Vec<BothModes> {
    type R = Dual<f64, 1>;
    let all = values::<f64>(s);
    let job = Job::new(s, &s.settings, 3, 0..2, &());
    let n = s.film.pixels() * 3;
    let adjoint: Vec<f32> = (0..n).map(|i| (1.3 * i as f32).sin()).collect();
    let active = Active::seen_by::<E, _>(s, names).expect("seen");
    let pulled = backward::<f64, E, Independent>(&job, &Theta::constant(&all), &active, &adjoint);
    let pulled = pulled.expect("admitted");
    let mut out = Vec::new();
    for (info, values) in active.ranges().iter().zip(&pulled.values) {
        for (i, &pulled) in values.iter().enumerate() {
            // All of them move, as in reverse mode: fields follow what is asked for.
            let mut tangents = vec![Tangent::None; s.params().infos().len()];
            for other in active.ranges() {
                let own = other.name == info.name;
                let unit = |k| R::new(0.0, [f64::from(u8::from(own && k == i))]);
                let id = s.params().handle(other).id as usize;
                tangents[id] = Tangent::Dense((0..other.range().len()).map(unit).collect());
            }
            let theta = Theta::<R>::with_tangents(&all, &tangents);
            let r = render::<R, E, Independent>(&job, &theta).expect("admitted");
            let products = r.sums[1].iter().zip(&adjoint);
            let products = products.map(|(s, &a)| s * f64::from(a) / 2.0);
            out.push(BothModes {
                what: format!("{} {i}", info.name),
                size: products.clone().map(f64::abs).sum(),
                pushed: products.sum(),
                pulled,
            });
        }
    }
    out
}

/// Asserts that both modes are the same linear map, to rounding, in all numbers of these parameters, and that none is zero.
///
/// # Panics
/// If they are not.
pub fn modes_are_one_map<E: Unbiased>(what: &str, s: &Scene, names: &[&str]) {
    for d in both_modes::<E>(s, names) {
        let what = format!("{what} {}", d.what);
        assert!(
            (d.pushed - d.pulled).abs() <= 1e-8 * d.size,
            "{what}: {} {} of {}",
            d.pushed,
            d.pulled,
            d.size
        );
        assert!(d.pulled.abs() > 1e-9, "{what} says nothing");
    }
}

/// A picture of these elements, of 16 by 16 pixels, by paths of so many edges.
pub fn scene(body: &str, depth: u32) -> Scene {
    let s = format!(
        r#"<integrator type="path"><integer name="max_depth" value="{depth}"/><integer name="rr_depth" value="100"/></integrator>
        <sensor type="perspective"><float name="fov" value="45"/>
            <transform name="to_world"><lookat origin="0, 3, 5" target="0, 0.4, 0" up="0, 1, 0"/></transform>
            <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/>
            <rfilter type="box"/></film></sensor>{body}"#
    );
    crate::scene(&s)
}

/// Materials `grey` and `metal`, a floor, and a lamp.
pub const FLOOR: &str = r#"
    <bsdf type="diffuse" id="grey"><rgb name="reflectance" value="0.6, 0.5, 0.4"/></bsdf>
    <bsdf type="roughconductor" id="metal"><float name="alpha" value="0.35"/></bsdf>
    <shape type="rectangle" id="floor"><transform name="to_world"><scale value="4"/><rotate x="1" angle="-90"/>
        </transform><ref id="grey"/></shape>
    <shape type="rectangle" id="lamp"><transform name="to_world"><scale value="0.6"/><rotate x="1" angle="90"/>
        <translate x="0.7" y="3" z="-0.3"/></transform>
        <emitter type="area"><rgb name="radiance" value="9, 10, 11"/></emitter></shape>"#;

/// A cube `it` above [`FLOOR`].
pub const CUBE: &str = r#"<shape type="cube" id="it"><transform name="to_world"><scale value="0.5"/><rotate y="1" angle="25"/>
    <rotate x="1" angle="20"/><translate y="1.1"/></transform><ref id="grey"/></shape>"#;
/// A ball `it`.
pub const BALL: &str = r#"<shape type="sphere" id="it"><float name="radius" value="0.6"/><transform name="to_world">
    <rotate y="1" angle="25"/><translate x="0.2" y="1.1" z="0.3"/></transform><ref id="grey"/></shape>"#;
/// A disk `it`.
pub const DISK: &str = r#"<shape type="disk" id="it"><transform name="to_world"><scale value="0.7"/><rotate x="1" angle="-60"/>
    <translate y="1.2"/></transform><bsdf type="twosided"><ref id="grey"/></bsdf></shape>"#;
/// A tube `it`.
pub const TUBE: &str = r#"<shape type="cylinder" id="it"><point name="p0" x="-0.6" y="1" z="0.2"/>
    <point name="p1" x="0.6" y="1.3" z="0"/><float name="radius" value="0.3"/>
    <bsdf type="twosided"><ref id="grey"/></bsdf></shape>"#;
