//! Known derivatives, and what must hold whatever they are.

use super::*;
use crate::Job;
use crate::estimator::DetachedMis;
use crate::integrator::sink::collect;
use crate::motion::rotation;
use crate::sampler::Independent;
use crate::scene::Scene;
use crate::statistics::{Estimate, z_limit};

const RUNS: u64 = 8;
const SIZE: f64 = 24.0;
const FOV: f64 = 50.0;

fn scene(body: &str, depth: u32) -> Scene {
    let text = format!(
        r#"<scene version="3.0.0">
        <integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
        <sensor type="perspective"><float name="fov" value="{FOV}"/>
            <film type="hdrfilm">
                <integer name="width" value="24"/><integer name="height" value="24"/>
                <rfilter type="box"/>
            </film>
        </sensor>{body}</scene>"#
    );
    match Scene::from_xml(&text, "".as_ref(), &Default::default()) {
        Ok((scene, _)) => scene,
        Err(e) => panic!("{e}\n{text}"),
    }
}

/// The derivative of the mean of all pixels and channels by outlines, in reverse mode.
fn gradient_of<P: Float>(scene: &Scene, names: &[&str], spp: u64) -> Vec<Estimate> {
    let found = names.iter().map(|n| scene.params().find(n).expect("known"));
    let active = Active::of(scene, &found.collect::<Vec<_>>());
    let values: Vec<P> = (scene.params().values().iter())
        .map(|&v| P::from_f32(v))
        .collect();
    let theta = Theta::constant(&values);
    let n = scene.film.pixels() * 3;
    let adjoint = vec![1.0 / n as f32; n];
    let runs: Vec<Vec<f64>> = (0..RUNS)
        .map(|seed| {
            let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
            let pass = Pass::new(&job, &theta, Caustics::Paths);
            let found = collect(scene, &active, 1.0, &(), &|large| {
                gradient::<P, DetachedMis, Independent>(&pass, &active, &adjoint, large)
            });
            assert_eq!(found.non_finite.count, 0);
            found.values.concat()
        })
        .collect();
    (0..runs[0].len())
        .map(|i| Estimate::of(&runs.iter().map(|r| r[i]).collect::<Vec<_>>()))
        .collect()
}

type Point = [f64; 2];
type Move<'a> = &'a dyn Fn(Vec3<f64>) -> Vec3<f64>;

/// On the film, in pixels.
fn project(p: &Vec3<f64>) -> Point {
    let scale = 0.5 * SIZE / (0.5 * FOV.to_radians()).tan();
    [-p.x / p.z, -p.y / p.z].map(|x| 0.5 * SIZE + scale * x)
}

/// The area of the convex hull of points, as far as it is on the film.
fn hull_area(points: &[Vec3<f64>]) -> f64 {
    let mut sorted: Vec<Point> = points.iter().map(project).collect();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let turn = |a: Point, b: Point, c: Point| {
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    };
    let half = |points: &mut dyn Iterator<Item = &Point>| {
        let mut chain: Vec<Point> = Vec::new();
        for &p in points {
            while let [.., a, b] = chain[..] {
                if turn(a, b, p) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut hull = half(&mut sorted.iter());
    hull.extend(half(&mut sorted.iter().rev()));
    for (axis, sign, limit) in [
        (0, 1.0, 0.0),
        (0, -1.0, -SIZE),
        (1, 1.0, 0.0),
        (1, -1.0, -SIZE),
    ] {
        let mut cut = Vec::new();
        for (i, &b) in hull.iter().enumerate() {
            let a = hull[(i + hull.len() - 1) % hull.len()];
            let [x, y] = [a, b].map(|p: Point| sign * p[axis] - limit);
            if (x < 0.0) != (y < 0.0) {
                let t = x / (x - y);
                cut.push([0, 1].map(|k: usize| a[k] + t * (b[k] - a[k])));
            }
            if y >= 0.0 {
                cut.push(b);
            }
        }
        hull = cut;
    }
    let pairs = hull.iter().zip(hull.iter().cycle().skip(1));
    0.5 * pairs
        .map(|(a, b)| a[0] * b[1] - a[1] * b[0])
        .sum::<f64>()
        .abs()
}

/// The derivative of an area on the film, as a mean over pixels, by everything that moves a shape or the camera:
/// translation, rotation and scale about `centre`; translation and rotation of the camera; angle of view.
fn derivatives(area: &dyn Fn(Move) -> f64, centre: Vec3<f64>) -> Vec<f64> {
    let unit = |k: usize, h: f64| {
        let mut v = [0.0; 3];
        v[k] = h;
        Vec3::from(v)
    };
    let h = 1e-5;
    let slope = |of: &dyn Fn(f64) -> f64| (of(h) - of(-h)) / (2.0 * h) / (SIZE * SIZE);
    let mut out = Vec::new();
    for k in 0..3 {
        out.push(slope(&|h| area(&|p| p + unit(k, h))));
    }
    for k in 0..3 {
        out.push(slope(&|h| {
            area(&|p| centre + rotation(unit(k, h)) * (p - centre))
        }));
    }
    out.push(slope(&|h| area(&|p| centre + (p - centre) * (1.0 + h))));
    for k in 0..3 {
        out.push(slope(&|h| area(&|p| p - unit(k, h))));
    }
    for k in 0..3 {
        out.push(slope(&|h| area(&|p| rotation(unit(k, -h)) * p)));
    }
    let angle = |h: f64| ((FOV + h) / 2.0).to_radians().tan() / (FOV / 2.0).to_radians().tan();
    out.push(slope(&|h| {
        area(&|p| Vec3::new(p.x / angle(h), p.y / angle(h), p.z))
    }));
    out
}

const ALL: [&str; 6] = [
    "it.translation",
    "it.rotation",
    "it.scale",
    "sensor.translation",
    "sensor.rotation",
    "sensor.fov",
];

fn emits(shape: &str) -> String {
    let light = r#"<emitter type="area"><rgb name="radiance" value="2, 1, 0"/></emitter>"#;
    shape.replace("LIGHT", light)
}

fn agrees(body: &str, expected: &[f64]) {
    let mut s = scene(&emits(body), 1);
    s.make_movable(&ALL).expect("known");
    let found = gradient_of::<f64>(&s, &ALL, 20);
    assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    for (i, (e, &x)) in found.iter().zip(expected).enumerate() {
        // Single precision of vertices, and what the clearance and the inside of edges leave.
        let se = e.se + 3e-5 * scale;
        let z = (e.mean - x) / se;
        assert!(
            z.abs() < z_limit(14, RUNS, 1e-3),
            "{i}: {} +- {}, not {x}\n{body}",
            e.mean,
            e.se
        );
        assert!(e.se < 0.02 * scale, "{i}: {e:?}");
    }
}

fn turned(points: &[[f64; 3]]) -> Vec<Vec3<f64>> {
    let m =
        rotation(Vec3::new(0.0f64, 1.0, 0.0) * 0.5) * rotation(Vec3::new(1.0f64, 0.0, 0.0) * 0.4);
    points
        .iter()
        .map(|&p| m * Vec3::from(p) + Vec3::new(0.3, -0.2, 5.0))
        .collect()
}

const TURNED: &str = r#"<transform name="to_world">
    <rotate x="1" angle="22.918311805232928"/><rotate y="1" angle="28.64788975654116"/>
    <translate x="0.3" y="-0.2" z="5"/></transform>"#;

/// Flat polygons, a disk, cubes and spheres of constant radiance before black, translated, turned and scaled, seen by a
/// camera that moves, too: the derivative of the mean image is that of an area on the film. The creases of a cube
/// count for nothing. 8 runs of 5760 samples of edges.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn outlines_are_those_of_areas_on_the_film() {
    let square = [
        [-1.0, -1.0, 0.0],
        [1.0, -1.0, 0.0],
        [1.0, 1.0, 0.0],
        [-1.0, 1.0, 0.0],
    ];
    let points = turned(&square);
    let centre = turned(&[[0.0; 3]])[0];
    let of = |points: &[Vec3<f64>]| {
        let points = points.to_vec();
        derivatives(
            &move |f| hull_area(&points.iter().map(|&p| f(p)).collect::<Vec<_>>()),
            centre,
        )
    };
    let both = r#"<bsdf type="twosided"><bsdf type="diffuse"/></bsdf>"#;
    let flip = r#"<boolean name="flip_normals" value="true"/>"#;
    agrees(
        &format!(r#"<shape type="rectangle" id="it">{flip}{TURNED}{both}LIGHT</shape>"#),
        &of(&points),
    );
    let cube: Vec<[f64; 3]> = (0..8)
        .map(|i| [i & 1, i >> 1 & 1, i >> 2].map(|b| f64::from(2 * b - 1)))
        .collect();
    agrees(
        &format!(r#"<shape type="cube" id="it">{TURNED}LIGHT</shape>"#),
        &of(&turned(&cube)),
    );
    let n = 20_000;
    let rim: Vec<[f64; 3]> = (0..n)
        .map(|i| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(n)).sin_cos();
            [cos, sin, 0.0]
        })
        .collect();
    agrees(
        &format!(r#"<shape type="disk" id="it">{flip}{TURNED}LIGHT</shape>"#),
        &of(&turned(&rim)),
    );
    // A tube between whose ends the camera is.
    let ends: Vec<[f64; 3]> = (rim.iter().map(|p| [p[0], p[1], -2.0]))
        .chain(rim.iter().map(|p| [p[0], p[1], 2.0]))
        .map(|[x, y, z]| [0.3 * x, z * 0.4, 0.3 * y])
        .collect();
    let tilt = |p: &[f64; 3]| {
        rotation(Vec3::new(0.0, 0.0, 0.3f64)) * Vec3::from(*p) + Vec3::new(0.3, -0.2, 5.0)
    };
    let tilted = r#"<transform name="to_world"><rotate z="1" angle="17.188733853924695"/>
        <translate x="0.3" y="-0.2" z="5"/></transform>"#;
    let tube = r#"<shape type="cylinder" id="it"><point name="p0" x="0" y="-0.8" z="0"/>
        <point name="p1" x="0" y="0.8" z="0"/><float name="radius" value="0.3"/>"#;
    let ends: Vec<_> = ends.iter().map(tilt).collect();
    agrees(&format!("{tube}{tilted}LIGHT</shape>"), &of(&ends));
    // A sphere, whose area on the film is known.
    let radius = 0.8;
    let sphere = derivatives(
        &|f| {
            let c = f(centre);
            let edge = |k: usize, d: f64| {
                let mut v = [0.0; 3];
                v[k] = d;
                f(centre + Vec3::from(v))
            };
            // What scales, scales the radius; the angle of view scales the film alone.
            let r = 0.5 * radius * (edge(2, 1.0) - edge(2, -1.0)).length();
            let wide =
                (edge(0, 1.0) - edge(0, -1.0)).length() / (edge(2, 1.0) - edge(2, -1.0)).length();
            let c = Vec3::new(c.x / wide, c.y / wide, c.z);
            let scale = 0.5 * SIZE / (0.5 * FOV.to_radians()).tan() * wide;
            let area = std::f64::consts::PI * r * r * (c.length_squared() - r * r).sqrt()
                / (c.z * c.z - r * r).powf(1.5);
            area * scale * scale
        },
        centre,
    );
    agrees(
        &format!(
            r#"<shape type="sphere" id="it"><float name="radius" value="{radius}"/>{TURNED}LIGHT</shape>"#
        ),
        &sphere,
    );
}

/// Two planes of constant radiance that fill the film and cross: where the one ends and the other begins is known, whatever
/// moves, one of the planes or the camera. As parallelograms, and one of them as a disk. 8 runs of 5760 samples.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn planes_that_cross_end_at_a_line() {
    let centres = [[0.5, 0.2, 5.0], [-0.3, -0.1, 5.5]].map(Vec3::from);
    let turns = [[0.1, -0.5, 0.0], [0.05, 0.4, 0.0]];
    let turn = |[x, y, _]: [f64; 3]| {
        rotation(Vec3::new(0.0f64, y, 0.0)) * rotation(Vec3::new(x, 0.0f64, 0.0))
    };
    let normals = turns.map(|t| turn(t) * Vec3::new(0.0, 0.0, 1.0));
    for kinds in [["rectangle", "rectangle"], ["disk", "rectangle"]] {
        let plane = |k: usize, id: &str| {
            let [x, y, z] = centres[k].to_array();
            let [ax, ay, _] = turns[k].map(f64::to_degrees);
            let bright = ["2, 1, 0", "1, 4, 7"][k];
            let kind = kinds[k];
            format!(
                r#"<shape type="{kind}" id="{id}"><boolean name="flip_normals" value="true"/>
                <transform name="to_world"><scale value="6"/><rotate x="1" angle="{ax}"/><rotate y="1" angle="{ay}"/>
                <translate x="{x}" y="{y}" z="{z}"/></transform>
                <emitter type="area"><rgb name="radiance" value="{bright}"/></emitter></shape>"#
            )
        };
        // The mean of the film where the plane `it` moves and the other one does not, over its part of the first.
        let mean = |it: usize, f: Move, camera: Move| {
            let at = |k: usize, p: Vec3<f64>| camera(if k == it { f(p) } else { p });
            let planes = [0, 1].map(|k| {
                let c = at(k, centres[k]);
                // From three points, since moves are of points.
                let frame = Frame::from_normal(normals[k]);
                let [a, b] = [frame.s, frame.t].map(|e| at(k, centres[k] + e) - c);
                let n = a.cross(b);
                n * n.dot(c).recip()
            });
            // One over the depth is linear on the film.
            let d = planes[0] - planes[1];
            let half = (0.5 * FOV.to_radians()).tan();
            let rows = 400;
            let part: f64 = (0..rows)
                .map(|i| {
                    let v = ((f64::from(i) + 0.5) / f64::from(rows) * 2.0 - 1.0) * half;
                    let u = -(d.z + d.y * v) / d.x;
                    assert!(u.abs() < half, "{u}");
                    u / (2.0 * half) / f64::from(rows)
                })
                .sum();
            // Of the first plane, 1; of the second one, 4; the first one is in front to the right or to the left.
            3.0 * part * d.x.signum()
        };
        for it in [0, 1] {
            let names = ["it", "other"];
            let body = format!("{}{}", plane(0, names[it]), plane(1, names[1 - it]));
            let mut s = scene(&body, 1);
            s.make_movable(&ALL).expect("known");
            let found = gradient_of::<f64>(&s, &ALL, 20);
            let h = 1e-5;
            let unit = |k: usize, h: f64| {
                let mut v = [0.0; 3];
                v[k] = h;
                Vec3::from(v)
            };
            let still = |p: Vec3<f64>| p;
            let slope = |of: &dyn Fn(f64) -> f64| (of(h) - of(-h)) / (2.0 * h);
            let centre = centres[it];
            let mut expected = Vec::new();
            for k in 0..3 {
                expected.push(slope(&|h| mean(it, &|p| p + unit(k, h), &still)));
            }
            for k in 0..3 {
                expected.push(slope(&|h| {
                    mean(
                        it,
                        &|p| centre + rotation(unit(k, h)) * (p - centre),
                        &still,
                    )
                }));
            }
            expected.push(0.0);
            for k in 0..3 {
                expected.push(slope(&|h| mean(it, &still, &|p| p - unit(k, h))));
            }
            for k in 0..3 {
                expected.push(slope(&|h| mean(it, &still, &|p| rotation(unit(k, -h)) * p)));
            }
            let angle =
                |h: f64| ((FOV + h) / 2.0).to_radians().tan() / (FOV / 2.0).to_radians().tan();
            expected.push(slope(&|h| {
                mean(it, &still, &|p| {
                    Vec3::new(p.x / angle(h), p.y / angle(h), p.z)
                })
            }));
            let scale = expected.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
            for (i, (e, &x)) in found.iter().zip(&expected).enumerate() {
                let z = (e.mean - x) / (e.se + 3e-5 * scale);
                assert!(
                    z.abs() < z_limit(28, RUNS, 1e-3),
                    "{kinds:?} {it} {i}: {e:?}, not {x}"
                );
                assert!(e.se < 0.02 * scale, "{kinds:?} {it} {i}: {e:?}");
            }
        }
    }
}

/// A room with a lamp, a cube that cuts a glossy plate, a ball that a tube goes through, all of which may move.
const ROOM: &str = r#"
    <bsdf type="diffuse" id="grey"><rgb name="reflectance" value="0.5, 0.4, 0.6"/></bsdf>
    <bsdf type="roughconductor" id="metal"><float name="alpha" value="0.4"/></bsdf>
    <shape type="cube" id="room"><boolean name="flip_normals" value="true"/>
        <transform name="to_world"><scale x="3" y="3" z="5"/></transform><ref id="grey"/></shape>
    <shape type="cube" id="block"><transform name="to_world"><scale value="0.4"/><rotate y="1" angle="30"/>
        <translate x="0.8" y="-1" z="3"/></transform><ref id="grey"/></shape>
    <shape type="sphere" id="ball"><point name="center" x="-0.7" y="-0.5" z="3"/>
        <float name="radius" value="0.6"/><ref id="grey"/></shape>
    <shape type="cylinder" id="tube"><point name="p0" x="-1.4" y="-0.4" z="2.9"/><point name="p1" x="0.5" y="0.1" z="3.2"/>
        <float name="radius" value="0.2"/><bsdf type="twosided"><ref id="grey"/></bsdf></shape>
    <shape type="disk" id="plate"><transform name="to_world"><scale value="0.5"/><rotate x="1" angle="70"/>
        <translate x="0.7" y="-0.7" z="2.8"/></transform><bsdf type="twosided"><ref id="metal"/></bsdf></shape>
    <shape type="rectangle" id="lamp"><transform name="to_world"><scale value="0.7"/><rotate x="1" angle="90"/>
        <translate y="2.5" z="2.5"/></transform>
        <emitter type="area"><rgb name="radiance" value="3, 4, 5"/></emitter></shape>"#;
const THINGS: [&str; 6] = ["room", "block", "ball", "tube", "plate", "lamp"];

fn room(depth: u32) -> Scene {
    let mut s = scene(ROOM, depth);
    let mut names: Vec<String> = THINGS.iter().map(|t| format!("{t}.translation")).collect();
    names.extend(THINGS.iter().map(|t| format!("{t}.rotation")));
    names.extend(["sensor.translation", "sensor.rotation"].map(String::from));
    s.make_movable(&names).expect("known");
    s
}

/// Where everything moves alike, the camera with it, nothing changes: every sample is zero by itself. So it is with turns about
/// a common pivot, which are turns of each thing about its own centre and moves of that: up to what rays beside edges are off
/// and geometry in single precision leaves.
#[test]
fn nothing_changes_where_all_move_alike() {
    let pivot = Vec3::new(0.4, -0.3, 1.7);
    for depth in [2, 4] {
        let s = room(depth);
        let all = THINGS.iter().chain([&"sensor"]);
        let [moves, turns] =
            ["translation", "rotation"].map(|key| all.clone().map(move |t| format!("{t}.{key}")));
        let names: Vec<String> = moves.chain(turns).collect();
        let names: Vec<&str> = names.iter().map(|n| n.as_str()).collect();
        let found = gradient_of::<f64>(&s, &names, 1);
        let vector = |i: usize| Vec3::from([0, 1, 2].map(|k: usize| found[3 * i + k].mean));
        let centres = s.shapes().iter().map(|shape| shape.centroid());
        let centres: Vec<[f64; 3]> = centres.chain([s.camera.origin()]).collect();
        assert_eq!(2 * centres.len(), names.len());
        let size = found.iter().fold(0.0, |m: f64, e| m.max(e.mean.abs()));
        assert!(size > 1e-3, "{depth}: {size}");
        let (mut moved, mut turned) = (Vec3::zero(), Vec3::zero());
        for (i, centre) in centres.iter().enumerate() {
            moved += vector(i);
            turned += vector(centres.len() + i) + (Vec3::from(*centre) - pivot).cross(vector(i));
        }
        for k in [moved.x, moved.y, moved.z] {
            assert!(k.abs() < 1e-9 * size, "{depth}: {moved:?} of {size}");
        }
        assert!(
            turned.length() < 1e-4 * size,
            "{depth}: {turned:?} of {size}"
        );
    }
}

/// A box that emits inwards lights nothing outside: no light passes its sides in their own planes.
#[test]
fn what_a_closed_box_holds_stays_there() {
    let names = ["floor.translation", "box.translation", "sensor.translation"];
    let mut s = scene(
        r#"<shape type="rectangle" id="floor"><transform name="to_world"><scale value="4"/><rotate x="1" angle="-90"/>
            <translate y="-1.5" z="3"/></transform></shape>
        <shape type="cube" id="box"><boolean name="flip_normals" value="true"/><transform name="to_world">
            <scale value="0.5"/><rotate x="1" y="2" angle="35"/><translate z="3"/></transform>
            <emitter type="area"/></shape>"#,
        2,
    );
    s.make_movable(&names).expect("known");
    for found in [
        gradient_of::<f64>(&s, &names, 16),
        gradient_of::<f32>(&s, &names, 16),
    ] {
        assert!(found.iter().all(|e| e.mean == 0.0), "{found:?}");
    }
}

/// Forward and reverse mode are one linear map.
#[test]
fn forward_is_reverse() {
    use crate::params::Tangent;
    use ad_core::Dual;
    let s = room(3);
    let names: Vec<&str> = (s.params().infos().iter())
        .filter(|i| i.kind.is_motion())
        .map(|i| i.name.as_str())
        .collect();
    let infos: Vec<_> = names
        .iter()
        .map(|n| s.params().find(n).expect("known"))
        .collect();
    let active = Active::of(&s, &infos);
    let values: Vec<f64> = s.params().values().iter().map(|&v| v.into()).collect();
    let n = s.film.pixels() * 3;
    let adjoint: Vec<f32> = (0..n).map(|i| (i % 7) as f32 / n as f32).collect();
    let job = Job::new(&s, &s.settings, 3, 0..1, &());
    let theta = Theta::constant(&values);
    let pass = Pass::new(&job, &theta, Caustics::Paths);
    let reverse = collect(&s, &active, 1.0, &(), &|large| {
        gradient::<f64, DetachedMis, Independent>(&pass, &active, &adjoint, large)
    });
    let reverse = reverse.values.concat();
    // All at once, each along a number of its own.
    let along = |i: usize| ((i * 37 % 11) as f64) - 5.0;
    let mut count = 0;
    let tangents: Vec<_> = (s.params().infos().iter())
        .map(|info| {
            if !info.kind.is_motion() {
                return Tangent::None;
            }
            let own = (0..info.shape.len()).map(|_| {
                count += 1;
                Dual::<f64, 1>::new(0.0, [along(count - 1)])
            });
            Tangent::Dense(own.collect())
        })
        .collect();
    let theta = Theta::with_tangents(&values, &tangents);
    let pass = Pass::new(&job, &theta, Caustics::Paths);
    let image = image::<Dual<f64, 1>, DetachedMis, Independent>(&pass);
    let forward: f64 = (image.sums[1].iter().zip(&adjoint))
        .map(|(s, &a)| s * f64::from(a))
        .sum();
    let expected: f64 = reverse.iter().enumerate().map(|(i, d)| d * along(i)).sum();
    let size: f64 = reverse
        .iter()
        .enumerate()
        .map(|(i, d)| (d * along(i)).abs())
        .sum();
    assert!(
        size > 1e-3 && (forward - expected).abs() < 1e-9 * size,
        "{forward} {expected}"
    );
    assert!(image.sums[0].iter().all(|x| *x == 0.0));
}

/// A half-plane between a floor and a uniform sky: the irradiance is known, and how it changes as the half-plane moves.
/// The camera is below it and sees the floor alone. 8 runs of 64 samples for each pixel.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn a_half_plane_hides_the_sky() {
    let body = r#"
        <emitter type="constant"><rgb name="radiance" value="1, 2, 3"/></emitter>
        <shape type="rectangle" id="floor"><transform name="to_world"><scale value="100"/>
            <rotate y="1" angle="180"/><translate z="2"/></transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.5, 0.5"/></bsdf></shape>
        <shape type="rectangle" id="it"><transform name="to_world"><scale x="100" y="400"/>
            <translate x="-99.7" z="-1"/></transform>
            <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf></bsdf></shape>"#;
    let mut s = scene(body, 2);
    let names = ["it.translation"];
    s.make_movable(&names).expect("known");
    let found = gradient_of::<f64>(&s, &names, 64);
    // Per unit of radiance: half of the sine of the angle of the edge to the vertical is hidden.
    let (edge, height) = (0.3, 3.0);
    let half = 2.0 * (0.5 * FOV.to_radians()).tan();
    let n = 2000;
    let mut expected = [0.0; 2];
    for i in 0..n {
        let x = ((f64::from(i) + 0.5) / f64::from(n) * 2.0 - 1.0) * half;
        let (to, r2) = (edge - x, (edge - x).powi(2) + height * height);
        let cosine = height / r2.sqrt();
        let scale = -0.5 * 0.5 * 2.0 * cosine / r2 / f64::from(n);
        expected[0] += scale * height;
        // Upwards is towards negative z.
        expected[1] += scale * to;
    }
    let known = [expected[0], 0.0, expected[1]];
    for (k, (e, x)) in found.iter().zip(known).enumerate() {
        let z = (e.mean - x) / e.se.hypot(1e-5);
        assert!(z.abs() < z_limit(3, RUNS, 1e-3), "{k}: {e:?}, not {x}");
        assert!(e.se < 0.02 * expected[0].abs(), "{k}: {e:?}");
    }
}

/// A plate behind another one, nearer to it than a thousandth of the distance: of its edges nothing is seen, whatever the
/// other one reflects, and what is seen does not change as it moves.
#[test]
fn what_is_just_before_an_edge_hides_it() {
    let body = r#"
        <emitter type="constant"><rgb name="radiance" value="1, 2, 3"/></emitter>
        <shape type="rectangle" id="cover"><transform name="to_world"><scale value="2"/><rotate y="1" angle="180"/>
            <translate z="5"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf></shape>
        <shape type="rectangle" id="it"><transform name="to_world"><scale value="0.7"/><rotate y="1" angle="180"/>
            <translate z="5.002"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.5, 0.5"/></bsdf></shape>"#;
    let mut s = scene(body, 2);
    let names = ["it.translation"];
    s.make_movable(&names).expect("known");
    let found = gradient_of::<f64>(&s, &names, 4);
    assert!(found.iter().all(|e| e.mean == 0.0), "{found:?}");
}

/// The same half-plane under a light that is a point: its shadow ends at a line, whatever of the two, the floor and the
/// camera moves. 8 runs of 256 samples for each pixel.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn a_half_plane_before_a_point() {
    let body = r#"
        <emitter type="point" id="light"><point name="position" x="0.1" y="0" z="-3"/>
            <rgb name="intensity" value="10, 20, 30"/></emitter>
        <shape type="rectangle" id="floor"><transform name="to_world"><scale value="100"/>
            <rotate y="1" angle="180"/><translate z="2"/></transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.5, 0.5"/></bsdf></shape>
        <shape type="rectangle" id="it"><transform name="to_world"><scale x="100" y="400"/>
            <translate x="-99.7" z="-1"/></transform>
            <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf></bsdf></shape>"#;
    let mut s = scene(body, 2);
    let names = [
        "it.translation",
        "light.position",
        "floor.translation",
        "sensor.translation",
    ];
    s.make_movable(&names).expect("known");
    let found = gradient_of::<f64>(&s, &names, 256);
    // Where the shadow ends on the film, per tangent of the angle, as the edge, the light, the floor and the camera move
    // along x and z.
    let half = (0.5 * FOV.to_radians()).tan();
    let end = |[x, z]: [f64; 2], [lx, lz]: [f64; 2], floor: f64, [cx, cz]: [f64; 2]| {
        let on_floor = lx + (x - lx) * (floor - lz) / (z - lz);
        (on_floor - cx) / (floor - cz)
    };
    let (edge, light, floor) = ([0.3, -1.0], [0.1, -3.0], 2.0);
    let at = |m: usize, axis: usize, h: f64| {
        let by = |i: usize| std::array::from_fn(|k| if i == m && k == axis { h } else { 0.0 });
        let add = |a: [f64; 2], b: [f64; 2]| [a[0] + b[0], a[1] + b[1]];
        end(add(edge, by(0)), add(light, by(1)), floor + by(2)[1], by(3))
    };
    // Light there, where half of the irradiance of a unit of intensity over pi is the radiance: a mean over y.
    let n = 2000;
    let x = at(9, 0, 0.0) * floor;
    assert!(x.abs() < half * floor, "{x}");
    let light: f64 = (0..n)
        .map(|i| {
            let y = ((f64::from(i) + 0.5) / f64::from(n) * 2.0 - 1.0) * half * floor;
            let (depth, across) = (floor - light[1], x - light[0]);
            let r2 = depth * depth + across * across + y * y;
            20.0 * 0.5 / std::f64::consts::PI * depth / (r2 * r2.sqrt()) / f64::from(n)
        })
        .sum();
    let h = 1e-5;
    for (m, what) in names.iter().enumerate() {
        for (axis, k) in [(0, 0), (1, 2)] {
            let speed = (at(m, axis, h) - at(m, axis, -h)) / (2.0 * h);
            let expected = -light * speed / (2.0 * half);
            let e = &found[3 * m + k];
            let z = (e.mean - expected) / e.se.hypot(1e-4 * light);
            assert!(
                z.abs() < z_limit(8, RUNS, 1e-3),
                "{what} {k}: {e:?}, not {expected}"
            );
            assert!(e.se < 0.02 * light, "{what} {k}: {e:?}");
        }
        let along = &found[3 * m + 1];
        let z = along.mean / along.se.hypot(1e-4 * light);
        assert!(z.abs() < z_limit(4, RUNS, 1e-2), "{what}: {along:?}");
    }
}

/// Black pyramids in a floor before the camera, below a bulb beside it, that sees all of their upper faces: what is not lit or
/// not seen is the square in the floor, whose place moves with them. They stand there, with a bottom and without, or have
/// their sides there and go on below, narrower or wider. The derivative of the mean image is an integral over the sides of that
/// square. 8 runs of 28800 samples of edges.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn what_stands_on_a_floor_is_no_shadow_on_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let bulb = Vec3::new(0.2, 0.1, 1.0);
    // Half the side of the square, the depth of the floor, the middle of the square.
    let (half, depth, middle) = (0.5, 5.0, [0.8, -0.4]);
    // The radiance of a point of the floor over the depth, as a mean over the film.
    let bright = |x: f64, y: f64| {
        let to = bulb - Vec3::new(x, y, depth);
        let lit = 0.5 / std::f64::consts::PI * 100.0 * -to.z / to.length().powi(3);
        let pixels = 0.5 / (0.5 * FOV.to_radians()).tan() / depth;
        lit * pixels * pixels
    };
    let n = 1000;
    // Over the side that looks along an axis, up or down.
    let side = |axis: usize, sign: f64| {
        let at = |i: i32| (f64::from(i) + 0.5) / f64::from(n) * 2.0 * half - half;
        let points = (0..n).map(|i| {
            let mut p = middle;
            p[axis] += sign * half;
            p[1 - axis] += at(i);
            bright(p[0], p[1])
        });
        points.sum::<f64>() * 2.0 * half / f64::from(n)
    };
    let expected = [0, 1].map(|axis| side(axis, -1.0) - side(axis, 1.0));
    let size = expected[0].hypot(expected[1]);
    let square = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let corners = |scale: f64, z: f64| -> String {
        let corner = |[x, y]: [f64; 2]| {
            let [x, y] = [middle[0] + scale * half * x, middle[1] + scale * half * y];
            format!("v {x} {y} {z}\n")
        };
        square.map(corner).concat()
    };
    let top = format!("{}v {} {} 4.9\n", corners(1.0, depth), middle[0], middle[1]);
    let upper = "f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n";
    let below = "f 1 6 7\nf 1 7 2\nf 2 7 8\nf 2 8 3\nf 3 8 9\nf 3 9 4\nf 4 9 6\nf 4 6 1\n";
    for (what, text) in [
        ("stands", format!("{top}{upper}f 1 3 2\nf 1 4 3\n")),
        ("is open", format!("{top}{upper}")),
        (
            "goes on",
            format!("{top}{}{upper}{below}", corners(0.8, depth + 0.4)),
        ),
        (
            "widens",
            format!("{top}{}{upper}{below}", corners(1.4, depth + 0.4)),
        ),
    ] {
        let path = folder.path().join("it.obj");
        std::fs::write(&path, text).expect("a file");
        let body = format!(
            r#"<bsdf type="diffuse" id="white"><rgb name="reflectance" value="0.5"/></bsdf>
            <shape type="rectangle" id="floor"><boolean name="flip_normals" value="true"/><transform name="to_world">
            <scale value="5"/><translate z="{depth}"/></transform><ref id="white"/></shape>
            <emitter type="point" id="bulb"><point name="position" x="0.2" y="0.1" z="1"/>
            <rgb name="intensity" value="100"/></emitter>
            <shape type="obj" id="it"><string name="filename" value="{}"/><boolean name="face_normals" value="true"/>
            <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf></shape>"#,
            path.display()
        );
        let mut s = scene(&body, 2);
        s.make_movable(&["it.translation"]).expect("known");
        let found = gradient_of::<f64>(&s, &["it.translation"], 100);
        for (e, x) in found.iter().zip(expected) {
            let se = e.se + 2e-3 * size;
            let z = (e.mean - x) / se;
            println!("{what}: {} +- {}, expected {x}", e.mean, e.se);
            assert!(z.abs() < z_limit(8, RUNS, 1e-3), "{what}: {e:?}, not {x}");
            assert!(e.se < 0.02 * size, "{what}: {e:?}");
        }
    }
}
