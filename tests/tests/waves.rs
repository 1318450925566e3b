//! Waves of paths do what single paths do: the same radiance bit by bit, the same derivatives to rounding.

use std::path::Path;

use ad_core::Dual;
use render::Job;
use render::estimator::{
    AttachedDirect, AttachedWeights, BsdfOnly, Detached, DetachedMis, DetachedWeights,
    Differential, EmitterOnly, Mis, Reparameterised, Sampling, Strategy,
};
use render::film::Image;
use render::image_io::write_exr;
use render::instances::{Direction, Estimator, backward_f64, render_f32};
use render::integrator::gradient::Active;
use render::integrator::path;
use render::integrator::render::Components;
use render::params::{Tangent, Theta};
use render::sampler::{Points, Purpose, Sampler, Spread};
use render::scene::{Caustics, LightChoice, LoadOptions, Settings};
use render::{Scene, auto};
use tests::cases::{self, Case};
use tests::{mean_adjoint, scene, smooth_params, values};

/// The sums over the samples of all pixels, path by path: as [`Rendering::sums`](render::Rendering).
fn single<R: Components<Primal = f32>, S: Strategy<Bsdf: Sampling<Geometry<R> = f32>>>(
    s: &Scene,
    theta: &Theta<R>,
    settings: &Settings,
    seed: u64,
    spp: u64,
) -> Vec<Vec<f64>> {
    let [width, height] = s.film.crop_size;
    let mut sums = vec![Vec::new(); R::COUNT];
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let mut sum = vec![[0.0; 3]; R::COUNT];
        for index in 0..spp {
            let pixel = u64::from(y) * u64::from(width) + u64::from(x);
            let mut sampler = Spread::spread(settings.points, seed, pixel, index);
            if s.camera.has_lens() {
                sampler.seek(Purpose::Lens.at(1));
            }
            let [dx, dy] = s.film.filter.sample(sampler.next_2d::<f32>());
            let place = if s.camera.has_lens() {
                sampler.next_2d::<f32>()
            } else {
                [0.0; 2]
            };
            let (x, y) = (x as f32 + 0.5 + dx, y as f32 + 0.5 + dy);
            let ray = s.camera.ray_through(x, y, place);
            let l = path::trace::<R, S, Spread, ()>(s, theta, settings, ray, sampler, &mut ());
            for (k, sum) in sum.iter_mut().enumerate() {
                for (sum, l) in sum.iter_mut().zip(l.to_array()) {
                    *sum += l.component(k);
                }
            }
        }
        for (sums, sum) in sums.iter_mut().zip(sum) {
            sums.extend(sum);
        }
    }
    sums
}

/// More than one material, emitter and kind of both in a room that light does not leave soon; 40 x 40 pixels, so that
/// waves are full for some edges and not for others.
fn room() -> Case {
    let wall = |id: &str, at: &str| {
        format!(
            r#"<shape type="rectangle"><transform name="to_world"><scale value="2"/>{at}</transform><ref id="{id}"/></shape>"#
        )
    };
    let diffuse = |id: &str, rgb: &str| {
        format!(r#"<bsdf type="diffuse" id="{id}"><rgb name="reflectance" value="{rgb}"/></bsdf>"#)
    };
    let body = [
        r#"<sensor type="perspective"><float name="fov" value="50"/>
           <transform name="to_world"><lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
           <film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="40"/></film></sensor>
           <integrator type="path"><integer name="max_depth" value="9"/><integer name="rr_depth" value="3"/></integrator>"#.to_string(),
        diffuse("white", "0.8, 0.8, 0.7"),
        diffuse("red", "0.7, 0, 0.1"),
        diffuse("black", "0"),
        wall("white", r#"<translate z="-2"/>"#),
        wall("white", r#"<rotate x="1" angle="-90"/><translate y="-2"/>"#),
        wall("black", r#"<rotate x="1" angle="90"/><translate y="2"/>"#),
        wall("red", r#"<rotate y="1" angle="90"/><translate x="-2"/>"#),
        wall("red", r#"<rotate y="1" angle="-90"/><translate x="2"/>"#),
        r#"<shape type="cube"><transform name="to_world"><scale value="0.5"/><rotate y="1" angle="30"/><translate x="-0.7" y="-1.5"/></transform>
           <bsdf type="twosided"><bsdf type="roughconductor" id="metal"><float name="alpha" value="0.3"/></bsdf></bsdf></shape>
           <shape type="sphere"><point name="center" value="0.8, -1.3, 0.3"/><float name="radius" value="0.7"/><bsdf type="dielectric"/></shape>
           <shape type="rectangle"><transform name="to_world"><scale value="0.5"/><rotate x="1" angle="90"/><translate y="1.9"/></transform>
           <ref id="black"/><emitter type="area" id="lamp"><rgb name="radiance" value="9, 8, 7"/></emitter></shape>
           <emitter type="point" id="bulb"><point name="position" value="0.5, 1, 1"/><rgb name="intensity" value="1, 2, 3"/></emitter>"#.to_string(),
    ];
    Case {
        name: "room",
        body: body.concat(),
    }
}

/// Ball lamps: in sight, around everything, turned inside out, and with an image.
fn lamps() -> Case {
    let ball = |x: f64, radius: f64, more: &str, emitter: &str| {
        format!(
            r#"<shape type="sphere"><point name="center" value="{x}, 0.4, 0.3"/><float name="radius" value="{radius}"/>{more}
               <bsdf type="diffuse"><rgb name="reflectance" value="0.1"/></bsdf><emitter type="area">{emitter}</emitter></shape>"#
        )
    };
    let glow = |rgb: &str| format!(r#"<rgb name="radiance" value="{rgb}"/>"#);
    let flipped = r#"<boolean name="flip_normals" value="true"/>"#;
    let squares = r#"<texture type="checkerboard" name="radiance"><rgb name="color0" value="3"/><rgb name="color1" value="1"/></texture>"#;
    let body = [
        r#"<sensor type="perspective"><float name="fov" value="50"/>
           <transform name="to_world"><lookat origin="0, 1, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
           <film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="40"/></film></sensor>
           <integrator type="path"><integer name="max_depth" value="5"/></integrator>
           <bsdf type="diffuse" id="white"><rgb name="reflectance" value="0.6"/></bsdf>
           <shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate x="1" angle="-90"/><translate y="-0.5"/></transform><ref id="white"/></shape>"#.to_string(),
        ball(-1.2, 0.3, "", &glow("4, 3, 2")),
        ball(-0.4, 0.02, "", &glow("900")),
        ball(0.4, 0.3, flipped, &glow("2")),
        ball(1.2, 0.3, "", squares),
        ball(0.0, 9.0, flipped, &glow("0.3")),
    ];
    Case {
        name: "lamps",
        body: body.concat(),
    }
}

/// Lights of all kinds that waves sample together, and some that they do not: as few as all paths sample, or so many that
/// paths are sorted by them, or so many that some are called one by one. `more`: how many points there are besides.
fn beacons(name: &'static str, more: usize) -> Case {
    let point = |i: usize| {
        let (x, y) = (0.3 * (i as f64 - 5.0), 0.4 + 0.07 * i as f64);
        format!(
            r#"<emitter type="point"><point name="position" value="{x}, {y}, 0.6"/><rgb name="intensity" value="0.4, 0.3, {y}"/></emitter>"#
        )
    };
    let spot = |at: &str, cutoff: f64, beam: f64| {
        format!(
            r#"<emitter type="spot"><transform name="to_world"><lookat origin="{at}" target="0, 0, 0" up="0, 0, 1"/></transform>
               <float name="cutoff_angle" value="{cutoff}"/><float name="beam_width" value="{beam}"/>
               <rgb name="intensity" value="5, 6, 4"/></emitter>"#
        )
    };
    let mut body = LIT.to_string();
    body += r#"<bsdf type="roughplastic" id="lacquer"><float name="alpha" value="0.2"/></bsdf>
        <shape type="rectangle"><transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform><ref id="lacquer"/></shape>
        <shape type="sphere"><point name="center" value="0, 0.4, 0"/><float name="radius" value="0.4"/><ref id="lacquer"/></shape>
        <shape type="sphere"><point name="center" value="1, 0.9, 0"/><float name="radius" value="0.1"/>
        <emitter type="area"><rgb name="radiance" value="8, 9, 7"/></emitter></shape>
        <emitter type="directional"><vector name="direction" value="-1, -2, 0.3"/><rgb name="irradiance" value="1, 0.9, 0.8"/></emitter>"#;
    body += &spot("1, 2, 1", 30.0, 10.0);
    body += &spot("-1, 2, 0", 20.0, 20.0);
    for i in 0..more {
        body += &point(i);
    }
    Case { name, body }
}

/// A picture of sums of sines in a folder.
fn picture(
    folder: &Path,
    name: &str,
    [width, height]: [usize; 2],
    value: fn(usize) -> f32,
) -> String {
    let data = (0..3 * width * height).map(value).collect();
    let path = folder.join(name);
    let image = Image {
        width,
        height,
        data,
    };
    write_exr(&path, &image).expect("a folder to write to");
    path.display().to_string()
}

/// Shapes that emit, even and with pictures: meshes with and without normals, cubes, disks and tubes, seen from outside and
/// from within.
fn lanterns(folder: &Path) -> Vec<String> {
    let mesh = folder.join("tent.obj");
    std::fs::write(&mesh, TENT).unwrap();
    let glow = picture(folder, "glow.exr", [8, 5], |i| {
        4.0 + 3.0 * (0.7 * i as f32).sin()
    });
    let print = format!(
        r#"<texture type="bitmap" name="radiance"><string name="filename" value="{glow}"/></texture>"#
    );
    let even = r#"<rgb name="radiance" value="5, 4, 3"/>"#;
    let lamp = |shape: &str, more: &str, radiance: &str| {
        format!(r#"<shape type="{shape}">{more}<emitter type="area">{radiance}</emitter></shape>"#)
    };
    let placed = |scale: f64, at: &str| {
        format!(r#"<transform name="to_world"><scale value="{scale}"/>{at}</transform>"#)
    };
    let file = format!(r#"<string name="filename" value="{}"/>"#, mesh.display());
    let flat = r#"<boolean name="face_normals" value="true"/>"#;
    let turned = r#"<boolean name="flip_normals" value="true"/>"#;
    let tent = |scale, at: &str, more: &str| format!("{file}{more}{}", placed(scale, at));
    let tube = |a: &str, b: &str, radius: f64, more: &str| {
        format!(
            r#"<point name="p0" value="{a}"/><point name="p1" value="{b}"/><float name="radius" value="{radius}"/>{more}"#
        )
    };
    let down = r#"<rotate x="1" angle="80"/>"#;
    vec![
        lamp(
            "obj",
            &tent(0.4, r#"<translate x="-0.8" y="1"/>"#, ""),
            &print,
        ),
        lamp(
            "obj",
            &tent(0.3, r#"<translate x="0.9" y="1.2"/>"#, flat),
            even,
        ),
        lamp("obj", &tent(-0.3, r#"<translate y="1.4"/>"#, turned), even),
        lamp(
            "cube",
            &placed(
                0.1,
                r#"<rotate x="1" y="1" angle="40"/><translate x="-0.4" y="1.1"/>"#,
            ),
            &print,
        ),
        lamp(
            "disk",
            &placed(0.3, &format!(r#"{down}<translate x="0.4" y="1.3"/>"#)),
            &print,
        ),
        lamp(
            "disk",
            &placed(0.2, &format!(r#"{down}<translate x="-1" y="1.5"/>"#)),
            even,
        ),
        lamp(
            "cylinder",
            &tube("-0.5, 0.9, 0.8", "0.3, 1, 0.7", 0.06, ""),
            even,
        ),
        // It is around everything, and the other one open to the viewer.
        lamp(
            "cylinder",
            &tube("0, -1, 0", "0, 5, 0", 9.0, turned),
            &print,
        ),
        lamp(
            "cylinder",
            &tube("1.1, 0, 0", "1.1, 0.3, 0.1", 0.3, turned),
            even,
        ),
    ]
}

/// Lights without a surface that throw pictures, and lobes around everything.
fn throwers(folder: &Path) -> Vec<String> {
    let slide = picture(folder, "slide.exr", [6, 7], |i| {
        3.0 + 2.0 * (1.1 * i as f32).sin()
    });
    let image = |name: &str| {
        format!(
            r#"<texture type="bitmap" name="{name}"><string name="filename" value="{slide}"/></texture>"#
        )
    };
    let from = |at: &str| {
        format!(
            r#"<transform name="to_world"><lookat origin="{at}" target="0, 0, 0" up="0, 1, 0.1"/></transform>"#
        )
    };
    let (irradiance, texture) = (image("irradiance"), image("texture"));
    let lobe = |kappa: f64, direction: &str| {
        format!(
            r#"<emitter type="vmf"><float name="kappa" value="{kappa}"/><vector name="direction" value="{direction}"/>
               <rgb name="radiance" value="1, 0.8, 0.6"/></emitter>"#
        )
    };
    let spot = |at: &str| {
        format!(
            r#"<emitter type="spot">{}<float name="cutoff_angle" value="35"/>{texture}</emitter>"#,
            from(at)
        )
    };
    vec![
        format!(
            r#"<emitter type="projector">{}<float name="scale" value="3"/><float name="fov" value="50"/>{irradiance}</emitter>"#,
            from("1, 2, 2")
        ),
        spot("-1, 2, 1"),
        lobe(3.0, "1, 2, 1"),
        lobe(300.0, "-1, 1, 0.5"),
        lobe(1e5, "0, 1, 1"),
    ]
}

/// These lights over a floor and a ball of lacquer, with so many points besides.
fn under(name: &'static str, lights: &[String], more: usize) -> (Case, Scene) {
    let point = |i: usize| {
        let (x, y) = (0.3 * (i as f64 - 5.0), 0.4 + 0.07 * i as f64);
        format!(
            r#"<emitter type="point"><point name="position" value="{x}, {y}, 0.6"/><rgb name="intensity" value="0.4, 0.3, {y}"/></emitter>"#
        )
    };
    let points: String = (0..more).map(point).collect();
    let body = format!(
        r#"{LIT}<bsdf type="roughplastic" id="lacquer"><float name="alpha" value="0.2"/></bsdf>
        <shape type="rectangle"><transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform><ref id="lacquer"/></shape>
        <shape type="sphere"><point name="center" value="0, 0.4, 0"/><float name="radius" value="0.4"/><ref id="lacquer"/></shape>{}{points}"#,
        lights.concat()
    );
    let scene = scene(&body);
    (Case { name, body }, scene)
}

/// Few lights that all paths sample, and so many that paths are sorted by them, or that some are called one by one.
fn lit() -> Vec<(Case, Scene)> {
    let folder = tempfile::tempdir().expect("a folder");
    let (shapes, throwers) = (lanterns(folder.path()), throwers(folder.path()));
    let all = [&*throwers, &*shapes].concat();
    vec![
        under("lanterns", &shapes[..6], 0),
        under("tubes", &shapes[6..], 0),
        under("throwers", &throwers, 0),
        under("all lights", &all, 0),
        under("more lights", &all, 9),
    ]
}

/// Pictures in all places of materials: colours, roughness, shares, opacities, normals and heights, within the image and
/// beyond it, on balls, plates and a mesh.
fn pictures() -> (Case, Scene) {
    let folder = tempfile::tempdir().expect("a folder");
    let noise = picture(folder.path(), "noise.exr", [16, 8], |i| {
        0.5 + 0.45 * (1.3 * i as f32).sin()
    });
    let normals = picture(folder.path(), "normals.exr", [7, 9], |i| match i % 3 {
        2 => 0.9,
        _ => 0.5 + 0.2 * (0.9 * i as f32).sin(),
    });
    let of = |file: &str, name: &str, more: &str| {
        format!(
            r#"<texture type="bitmap" name="{name}"><string name="filename" value="{file}"/>{more}</texture>"#
        )
    };
    let image = |name: &str| of(&noise, name, "");
    let wide = |name: &str| {
        of(
            &noise,
            name,
            r#"<transform name="to_uv"><scale value="1.7"/></transform>"#,
        )
    };
    let clamped = |name: &str| of(&noise, name, r#"<string name="wrap_mode" value="clamp"/>"#);
    let bsdf = |plugin: &str, inside: &[String]| {
        format!(r#"<bsdf type="{plugin}">{}</bsdf>"#, inside.concat())
    };
    let metal = bsdf(
        "roughconductor",
        &[image("alpha"), wide("specular_reflectance")],
    );
    let brushed = bsdf("roughconductor", &[wide("alpha_u"), image("alpha_v")]);
    let lacquer = bsdf(
        "roughplastic",
        &[image("alpha"), image("diffuse_reflectance")],
    );
    let glass = bsdf(
        "roughdielectric",
        &[clamped("alpha"), wide("specular_transmittance")],
    );
    let paint = bsdf(
        "principled",
        &[
            image("base_color"),
            image("roughness"),
            wide("metallic"),
            wide("clearcoat"),
        ],
    );
    let page = bsdf("principledthin", &[wide("base_color"), image("diff_trans")]);
    let tiles = bsdf("diffuse", &[wide("reflectance")]);
    let mask = |inner: &str| bsdf("mask", &[image("opacity"), inner.into()]);
    let blend = |a: &str, b: &str| bsdf("blendbsdf", &[wide("weight"), a.into(), b.into()]);
    let tilted = |inner: &str| bsdf("normalmap", &[of(&normals, "normalmap", ""), inner.into()]);
    let bump = |inner: &str| {
        bsdf(
            "bumpmap",
            &[wide("map"), number("scale", 0.05), inner.into()],
        )
    };
    let both = |a: &str, b: &str| bsdf("twosided", &[a.into(), b.into()]);
    let balls = [
        metal.clone(),
        lacquer.clone(),
        glass.clone(),
        paint.clone(),
        tilted(&metal),
        bump(&lacquer),
        bump(&mask(&glass)),
    ];
    let plates = [
        both(&brushed, ""),
        both(&metal, &paint),
        page.clone(),
        mask(&lacquer),
        blend(&tiles, &metal),
        both(&tilted(&tiles), &bump(&metal)),
        both(&bump(&paint), ""),
        blend(&both(&lacquer, ""), &glass),
    ];
    let case = rows("pictures", &balls, &plates);
    let mesh = folder.path().join("tent.obj");
    std::fs::write(&mesh, TENT).unwrap();
    let tent = |x: f64, bsdf: &str| {
        format!(
            r#"<shape type="obj"><string name="filename" value="{}"/><transform name="to_world"><scale value="0.5"/>
               <translate x="{x}" z="1.4"/></transform>{bsdf}</shape>"#,
            mesh.display()
        )
    };
    let tents = tent(-1.0, &bump(&metal))
        + &tent(0.0, &both(&bump(&tiles), &paint))
        + &tent(1.0, &both(&bump(&lacquer), ""));
    let body = format!("{}{tents}", case.body);
    let scene = scene(&body);
    (Case { body, ..case }, scene)
}

/// Glossy things seen through a lens, and by parallel rays.
fn lenses() -> [Case; 2] {
    let glossy = cases::all().into_iter().find(|c| c.name == "ggx");
    let body = glossy.expect("a case").body;
    let pinhole = "<sensor type=\"perspective\">\n        <float name=\"fov\" value=\"40\"/>";
    let seen_by = |name, sensor: &str| {
        let body = body.replace(pinhole, sensor);
        assert!(body.contains(sensor));
        Case { name, body }
    };
    let lens = "<sensor type=\"thinlens\"><float name=\"aperture_radius\" value=\"0.2\"/><float name=\"focus_distance\" value=\"4\"/>";
    [
        seen_by("lens", lens),
        seen_by("parallel", "<sensor type=\"orthographic\">"),
    ]
}

/// Everything that goes through a loop of its own, several of each at a vertex or none: metals of all normals, one-sided
/// and two-sided, seen from the front and from behind, and two-sided diffuse things, under a sky and lamps.
fn court() -> (Case, Scene) {
    let folder = tempfile::tempdir().expect("a folder");
    let picture = |name: &str, size, value| picture(folder.path(), name, size, value);
    // Bright in places, and black in others.
    let sky = picture("sky.exr", [12, 7], |i| {
        (4.0 * (0.37 * i as f32).sin() - 1.0).max(0.0)
    });
    let tiles = picture("tiles.exr", [4, 4], |i| 0.5 + 0.4 * (1.3 * i as f32).sin());
    let metal = |kind: &str, alpha: f64, material: &str| {
        format!(
            r#"<bsdf type="roughconductor"><string name="distribution" value="{kind}"/>
               <float name="alpha" value="{alpha}"/><string name="material" value="{material}"/></bsdf>"#
        )
    };
    let both = |inner: &str| format!(r#"<bsdf type="twosided">{inner}</bsdf>"#);
    let mirror = |material: &str| {
        format!(r#"<bsdf type="conductor"><string name="material" value="{material}"/></bsdf>"#)
    };
    let plate = |at: &str, bsdf: &str| {
        format!(
            r#"<shape type="rectangle"><transform name="to_world"><scale value="0.5"/>{at}</transform>{bsdf}</shape>"#
        )
    };
    let ball = |x: f64, bsdf: &str| {
        format!(
            r#"<shape type="sphere"><point name="center" value="{x}, -0.2, 0.4"/><float name="radius" value="0.3"/>{bsdf}</shape>"#
        )
    };
    // Within the image and beyond it, and images of which lookups are found one by one.
    let tiled = |more: &str| {
        format!(
            r#"<bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename" value="{tiles}"/>
               <transform name="to_uv"><scale value="1.7"/></transform>{more}</texture></bsdf>"#
        )
    };
    let floor = tiled("");
    let turned = tiled(r#"<string name="wrap_mode" value="mirror"/>"#);
    let squares = tiled(r#"<string name="filter_type" value="nearest"/>"#);
    let board = format!(
        r#"<bsdf type="roughplastic"><texture type="checkerboard" name="diffuse_reflectance">
           <texture type="bitmap" name="color0"><string name="filename" value="{tiles}"/></texture>
           <rgb name="color1" value="0.2, 0.4, 0.6"/></texture><texture type="checkerboard" name="alpha">
           <float name="color0" value="0.3"/><texture type="bitmap" name="color1"><string name="filename" value="{tiles}"/>
           <string name="filter_type" value="nearest"/></texture></texture></bsdf>"#
    );
    let lamp = |at: &str, radiance: &str| {
        format!(
            r#"<shape type="rectangle"><transform name="to_world"><scale value="0.3"/><rotate x="1" angle="90"/>{at}</transform>
               <emitter type="area"><rgb name="radiance" value="{radiance}"/></emitter></shape>"#
        )
    };
    let body = [
        r#"<sensor type="perspective"><float name="fov" value="50"/>
           <transform name="to_world"><lookat origin="0, 1, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
           <film type="hdrfilm"><integer name="width" value="20"/><integer name="height" value="20"/></film></sensor>
           <integrator type="path"><integer name="max_depth" value="6"/></integrator>"#
            .to_string(),
        plate(
            r#"<scale value="6"/><rotate x="1" angle="90"/><translate y="-0.5"/>"#,
            &both(&floor),
        ),
        plate(r#"<translate x="-1" z="-0.5"/>"#, &both(&metal("ggx", 0.2, "Cu"))),
        plate(
            r#"<rotate y="1" angle="160"/><translate x="0" z="-0.6"/>"#,
            &both(&metal("beckmann", 0.4, "none")),
        ),
        plate(
            r#"<rotate y="1" angle="200"/><translate x="1" z="-0.5"/>"#,
            &both(&mirror("Au")),
        ),
        ball(-0.8, &metal("ggx", 0.6, "none")),
        ball(0.0, &metal("beckmann", 0.1, "Al")),
        ball(0.8, &mirror("none")),
        ball(-1.6, &turned),
        ball(1.6, &squares),
        ball(2.4, &board),
        lamp(r#"<translate x="-0.7" y="1.2"/>"#, "7, 6, 5"),
        lamp(r#"<translate x="0.7" y="1.4"/>"#, "3, 4, 5"),
        format!(
            r#"<emitter type="envmap" id="sky"><string name="filename" value="{sky}"/>
               <transform name="to_world"><rotate x="1" z="0.4" angle="35"/></transform></emitter>"#
        ),
    ];
    let body = body.concat();
    let scene = scene(&body);
    let name = "court";
    (Case { name, body }, scene)
}

/// A camera, a lamp above and a sky.
const LIT: &str = r#"<sensor type="perspective"><float name="fov" value="50"/>
        <transform name="to_world"><lookat origin="0, 1, 4" target="0, 0.4, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="20"/><integer name="height" value="20"/></film></sensor>
        <integrator type="path"><integer name="max_depth" value="5"/></integrator>
        <shape type="rectangle"><transform name="to_world"><scale value="0.5"/><rotate x="1" angle="90"/><translate y="2.5" z="1"/></transform>
        <emitter type="area"><rgb name="radiance" value="7, 6, 5"/></emitter></shape>
        <emitter type="constant" id="sky"><rgb name="radiance" value="0.3, 0.4, 0.5"/></emitter>"#;

/// A mesh with texture coordinates and interpolated normals.
const TENT: &str = "v -1 0 0\nv 1 0 0\nv 0 0.4 0.5\nv 0 1.2 -0.3\nvt 0 0\nvt 1 0.2\nvt 0.4 0.6\nvt 0.5 1\n\
    vn 0 0.2 1\nvn 0.3 0.3 1\nf 1/1/1 2/2/2 3/3/1\nf 1/1/1 3/3/1 4/4/2\nf 3/3/1 2/2/2 4/4/2\n";

/// A ball and a mesh under bump maps, one of them over a textured blend.
fn bumps() -> (Case, Scene) {
    let dir = tempfile::tempdir().unwrap();
    let heights = dir.path().join("heights.exr");
    let noise = (0..16 * 8 * 3).map(|i| ((i / 3 * 7919 % 101) as f32) / 101.0);
    let image = Image {
        width: 16,
        height: 8,
        data: noise.collect(),
    };
    write_exr(&heights, &image).unwrap();
    let mesh = dir.path().join("tent.obj");
    std::fs::write(&mesh, TENT).unwrap();
    let (heights, mesh) = (heights.display(), mesh.display());
    let bitmap = |name: &str| {
        format!(
            r#"<texture name="{name}" type="bitmap"><string name="filename" value="{heights}"/></texture>"#
        )
    };
    let bump = |nested: &str| {
        let map = bitmap("map");
        format!(r#"<bsdf type="bumpmap">{map}<float name="scale" value="0.1"/>{nested}</bsdf>"#)
    };
    let metal = r#"<bsdf type="roughconductor"><float name="alpha" value="0.2"/></bsdf>"#;
    let tiles = format!(r#"<bsdf type="diffuse">{}</bsdf>"#, bitmap("reflectance"));
    let blend = format!(
        r#"<bsdf type="blendbsdf">{}{metal}{tiles}</bsdf>"#,
        bitmap("weight")
    );
    let (ball, tent) = (bump(metal), bump(&blend));
    let body = format!(
        r#"{LIT}
        <shape type="sphere"><point name="center" value="-0.7, 0.4, 0.6"/><float name="radius" value="0.4"/>{ball}</shape>
        <shape type="obj"><string name="filename" value="{mesh}"/><bsdf type="twosided">{tent}</bsdf></shape>"#
    );
    let scene = scene(&body);
    let name = "bumps";
    (Case { name, body }, scene)
}

/// Instances of metal over a floor, one of them mirrored.
fn instances() -> (Case, Scene) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("tent.obj");
    std::fs::write(&path, TENT).unwrap();
    let path = path.display();
    let instance = |at: &str| {
        format!(
            r#"<shape type="instance"><ref id="group"/><transform name="to_world">{at}</transform></shape>"#
        )
    };
    let body = format!(
        r#"{LIT}
        <shape type="rectangle"><transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform></shape>
        <shape type="shapegroup" id="group"><shape type="obj"><string name="filename" value="{path}"/><bsdf type="twosided">
        <bsdf type="roughconductor"><float name="alpha" value="0.2"/></bsdf></bsdf></shape></shape>{}{}{}"#,
        instance(r#"<translate x="-1" z="0.5"/>"#),
        instance(r#"<scale value="0.5, 0.9, 1.2"/><rotate y="1" angle="50"/><translate x="0.5"/>"#),
        instance(r#"<scale x="-0.6" y="0.6" z="0.6"/><translate x="1" y="0.2" z="0.8"/>"#),
    );
    let scene = scene(&body);
    let name = "instances";
    (Case { name, body }, scene)
}

/// Balls and plates of these materials in rows, seen from above, over a floor.
fn rows(name: &'static str, balls: &[String], plates: &[String]) -> Case {
    let ball = |(i, bsdf): (usize, &String)| {
        let x = 0.6 * i as f64 - 0.3 * (balls.len() - 1) as f64;
        format!(
            r#"<shape type="sphere"><point name="center" value="{x}, 0.3, 0.9"/><float name="radius" value="0.28"/>{bsdf}</shape>"#
        )
    };
    // Every other one is seen from behind.
    let plate = |(i, bsdf): (usize, &String)| {
        let (x, turn) = (
            0.7 * i as f64 - 0.35 * (plates.len() - 1) as f64,
            180 * (i % 2),
        );
        format!(
            r#"<shape type="rectangle"><transform name="to_world"><scale value="0.33"/><rotate y="1" angle="{turn}"/>
            <rotate x="1" angle="-20"/><translate x="{x}" y="0.9" z="-0.2"/></transform>{bsdf}</shape>"#
        )
    };
    let things = (balls.iter().enumerate().map(ball)).chain(plates.iter().enumerate().map(plate));
    let things: String = things.collect();
    let body = format!(
        r#"{}{things}
        <shape type="rectangle"><transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform></shape>"#,
        LIT.replace(r#""max_depth" value="5""#, r#""max_depth" value="7""#)
    );
    Case { name, body }
}

const SQUARES: &str =
    r#"type="checkerboard"><transform name="to_uv"><scale value="5"/></transform>"#;

/// A number of a material.
fn number(name: &str, x: f64) -> String {
    format!(r#"<float name="{name}" value="{x}"/>"#)
}

/// One that changes over the surface, from square to square.
fn squares(name: &str, [a, b]: [f64; 2]) -> String {
    format!(
        r#"<texture name="{name}" {SQUARES}<float name="color0" value="{a}"/><float name="color1" value="{b}"/></texture>"#
    )
}

/// Every kind of glass and plastic: denser and thinner inside, smooth, nearly smooth and rough, the same everywhere and
/// textured, from the front, from behind, and with another side. Brushed metal and glass besides.
fn cabinet(smoothest: f64) -> Case {
    let colours = |name: &str| {
        format!(
            r#"<texture name="{name}" {SQUARES}<rgb name="color0" value="0.7, 0.3, 0.2"/><rgb name="color1" value="0.1, 0.5, 0.9"/></texture>"#
        )
    };
    let alphas = format!(
        r#"<texture name="alpha" {SQUARES}<float name="color0" value="0.02"/><float name="color1" value="0.5"/></texture>"#
    );
    let glass =
        |index: &str, more: &str| format!(r#"<bsdf type="dielectric">{index}{more}</bsdf>"#);
    let rough = |kind: &str, plugin: &str, more: &str| {
        format!(
            r#"<bsdf type="{plugin}"><string name="distribution" value="{kind}"/>{more}</bsdf>"#
        )
    };
    let alpha = |alpha: f64| format!(r#"<float name="alpha" value="{alpha}"/>"#);
    let brushed = r#"<float name="alpha_u" value="0.4"/><float name="alpha_v" value="0.1"/>"#;
    let denser = r#"<float name="int_ior" value="1.6"/>"#;
    let thinner = r#"<float name="int_ior" value="1"/><float name="ext_ior" value="1.5"/>"#;
    let both = |a: &str, b: &str| format!(r#"<bsdf type="twosided">{a}{b}</bsdf>"#);
    let plastic = format!(
        r#"<bsdf type="plastic"><boolean name="nonlinear" value="true"/>{}</bsdf>"#,
        colours("diffuse_reflectance")
    );
    let black = r#"<bsdf type="plastic"><rgb name="diffuse_reflectance" value="0"/><rgb name="specular_reflectance" value="0"/></bsdf>"#;
    let red = r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.2, 0.1"/></bsdf>"#;
    let tiles = format!(r#"<bsdf type="diffuse">{}</bsdf>"#, colours("reflectance"));
    let balls = [
        glass(denser, &colours("specular_transmittance")),
        glass(thinner, ""),
        rough("ggx", "roughdielectric", &format!("{denser}{alphas}")),
        rough(
            "beckmann",
            "roughdielectric",
            &format!("{thinner}{}", alpha(0.3)),
        ),
        rough(
            "ggx",
            "roughdielectric",
            &format!("{denser}{}", alpha(smoothest)),
        ),
        rough(
            "ggx",
            "roughplastic",
            &format!("{}{}", alpha(smoothest), colours("diffuse_reflectance")),
        ),
        rough("beckmann", "roughplastic", &alphas),
        plastic.clone(),
    ];
    let plates = [
        r#"<bsdf type="thindielectric"><rgb name="specular_reflectance" value="0.9, 0.5, 0.7"/></bsdf>"#.to_string(),
        both(&plastic, ""),
        both(&rough("ggx", "roughplastic", &alpha(0.2)), black),
        both(red, &rough("ggx", "roughplastic", &alpha(0.7))),
        both(red, &tiles),
        both(r#"<bsdf type="conductor"/>"#, &tiles),
        rough("beckmann", "roughdielectric", &format!("{denser}{}", alpha(0.02))),
        both(&rough("ggx", "roughconductor", brushed), ""),
        rough("beckmann", "roughconductor", brushed),
        rough("ggx", "roughdielectric", brushed),
        rough("beckmann", "roughdielectric", brushed),
    ];
    rows("cabinet", &balls, &plates)
}

/// Principled materials with none, some and all of their parts: the same everywhere and textured, from the front, from
/// behind, with another side, and in mixtures. Blinn-Phong ones, and what is not there, besides.
fn principles() -> Case {
    let principled = |content: &str| format!(r#"<bsdf type="principled">{content}</bsdf>"#);
    let colours = format!(
        r#"<texture name="base_color" {SQUARES}<rgb name="color0" value="0.7, 0.3, 0.2"/><rgb name="color1" value="0, 0, 0"/></texture>"#
    );
    let all = |names: &[&str]| -> String { names.iter().map(|n| squares(n, [0.0, 0.8])).collect() };
    let (metal, glass) = (number("metallic", 0.8), number("spec_trans", 0.9));
    let index = number("eta", 1.6);
    let soft = ["flatness", "sheen", "sheen_tint"];
    let coat = ["clearcoat", "clearcoat_gloss"];
    let everything = format!(
        "{colours}{}{}{}{}{}",
        squares("roughness", [0.0, 0.9]),
        number("specular", 0.6),
        all(&["metallic", "spec_trans", "spec_tint"]),
        all(&soft),
        all(&coat)
    );
    let brushed = number("anisotropic", 0.8);
    let balls = [
        principled(&metal),
        principled(&format!("{metal}{}", number("specular", 0.0))),
        principled(&format!("{index}{}", all(&coat))),
        principled(&format!("{colours}{}", all(&soft))),
        principled(&format!("{glass}{index}")),
        principled(&everything),
        principled(&format!("{everything}{brushed}")),
        principled(&format!("{metal}{}", squares("anisotropic", [0.0, 1.0]))),
    ];
    let both = |a: &str, b: &str| format!(r#"<bsdf type="twosided">{a}{b}</bsdf>"#);
    let [plain, lacquer, frosted] = [
        principled(&colours),
        principled(&all(&coat)),
        principled(&format!("{glass}{brushed}")),
    ];
    let weight = squares("weight", [0.3, 1.0]);
    let opacity = squares("opacity", [0.1, 0.7]);
    let tilt = format!(
        r#"<texture name="normalmap" {SQUARES}<rgb name="color0" value="0.9, 0.4, 0.7"/><rgb name="color1" value="0.42, 0.55, 0.9"/></texture>"#
    );
    let phong = format!(
        r#"<bsdf type="blinnphong">{}</bsdf>"#,
        squares("exponent", [0.0, 2e3])
    );
    let cosine =
        r#"<bsdf type="blinnphong"><boolean name="importance_sampling" value="false"/></bsdf>"#;
    let nothing = r#"<bsdf type="null"/>"#;
    let plates = [
        both(&plain, ""),
        both(&lacquer, &plain),
        frosted.clone(),
        format!(r#"<bsdf type="mask">{opacity}{frosted}</bsdf>"#),
        format!(
            r#"<bsdf type="mask">{opacity}{}</bsdf>"#,
            both(&lacquer, "")
        ),
        format!(r#"<bsdf type="blendbsdf">{weight}{plain}{lacquer}</bsdf>"#),
        format!(r#"<bsdf type="normalmap">{tilt}{frosted}</bsdf>"#),
        both(
            &format!(r#"<bsdf type="normalmap">{tilt}{lacquer}</bsdf>"#),
            "",
        ),
        both(&phong, cosine),
        phong.clone(),
        nothing.to_string(),
        format!(r#"<bsdf type="blendbsdf">{weight}{nothing}{phong}</bsdf>"#),
    ];
    rows("principles", &balls, &plates)
}

/// Thin principled materials with none, some and all of their parts: the same everywhere and textured, from the front, from
/// behind, on both sides, and in mixtures, some of them with hair.
fn leaves() -> Case {
    let thin = |content: &str| format!(r#"<bsdf type="principledthin">{content}</bsdf>"#);
    let colours = format!(
        r#"<texture name="base_color" {SQUARES}<rgb name="color0" value="0.7, 0.3, 0.2"/><rgb name="color1" value="0, 0, 0"/></texture>"#
    );
    let all = |names: &[&str]| -> String { names.iter().map(|n| squares(n, [0.0, 0.8])).collect() };
    let soft = all(&["flatness", "sheen", "sheen_tint"]);
    let pane = |share: f64| format!("{}{}", number("spec_trans", share), number("eta", 1.4));
    let paper = format!("{colours}{}", squares("diff_trans", [0.0, 1.7]));
    let everything = format!(
        "{paper}{soft}{}{}{}",
        squares("roughness", [0.0, 0.9]),
        squares("eta", [1.01, 2.0]),
        all(&["spec_trans", "spec_tint"])
    );
    let brushed = number("anisotropic", 0.8);
    let hair = format!(
        r#"<bsdf type="hair">{}</bsdf>"#,
        squares("eumelanin", [0.0, 2.0])
    );
    let balls = [
        thin(""),
        thin(&colours),
        thin(&paper),
        thin(&format!("{paper}{soft}")),
        thin(&pane(1.0)),
        thin(&format!("{}{}", pane(0.6), number("roughness", 0.0))),
        thin(&everything),
        thin(&format!("{everything}{brushed}")),
    ];
    let [page, window, cloth, mat] = [
        thin(&paper),
        thin(&format!(
            "{}{}",
            pane(0.7),
            squares("anisotropic", [0.0, 1.0])
        )),
        thin(&everything),
        thin(&format!("{colours}{brushed}")),
    ];
    let weight = squares("weight", [0.3, 1.0]);
    let opacity = squares("opacity", [0.1, 0.7]);
    let tilt = format!(
        r#"<texture name="normalmap" {SQUARES}<rgb name="color0" value="0.9, 0.4, 0.7"/><rgb name="color1" value="0.42, 0.55, 0.9"/></texture>"#
    );
    let plates = [
        page.clone(),
        window.clone(),
        mat.clone(),
        thin(&format!("{colours}{soft}")),
        format!(r#"<bsdf type="mask">{opacity}{cloth}</bsdf>"#),
        format!(r#"<bsdf type="blendbsdf">{weight}{page}{window}</bsdf>"#),
        format!(r#"<bsdf type="blendbsdf">{weight}{cloth}{hair}</bsdf>"#),
        format!(r#"<bsdf type="normalmap">{tilt}{window}</bsdf>"#),
    ];
    rows("leaves", &balls, &plates)
}

/// Hair: the same everywhere and textured, of all roughness, with and without absorption, on balls, plates and curves, and in
/// mixtures.
fn strands() -> (Case, Scene) {
    let hair = |content: &str| format!(r#"<bsdf type="hair">{content}</bsdf>"#);
    let rough = |along: f64, around: f64| {
        let along = number("longitudinal_roughness", along);
        format!("{along}{}", number("azimuthal_roughness", around))
    };
    let dyed = format!(
        r#"<texture name="sigma_a" {SQUARES}<rgb name="color0" value="0.1, 0.4, 0.8"/><rgb name="color1" value="0, 0, 300"/></texture>"#
    );
    let white = r#"<rgb name="sigma_a" value="0"/>"#;
    let patterned = format!(
        "{}{}{}{}",
        squares("eumelanin", [0.0, 4.0]),
        squares("pheomelanin", [0.0, 1.0]),
        squares("longitudinal_roughness", [0.05, 0.7]),
        squares("azimuthal_roughness", [0.08, 1.0])
    );
    let balls = [
        hair(""),
        hair(&rough(0.01, 0.01)),
        hair(&rough(1.0, 1.0)),
        hair(&format!("{white}{}", rough(0.5, 0.2))),
        hair(&format!("{dyed}{}", number("scale_tilt", -60.0))),
        hair(&patterned),
    ];
    let metal = r#"<bsdf type="roughconductor"><float name="alpha" value="0.2"/></bsdf>"#;
    let tilt = format!(
        r#"<texture name="normalmap" {SQUARES}<rgb name="color0" value="0.9, 0.4, 0.7"/><rgb name="color1" value="0.42, 0.55, 0.9"/></texture>"#
    );
    let (opacity, weight) = (
        squares("opacity", [0.1, 0.7]),
        squares("weight", [0.3, 1.0]),
    );
    let [furs, dark] = [hair(&patterned), hair(&number("eumelanin", 8.0))];
    let plates = [
        furs.clone(),
        dark.clone(),
        format!(r#"<bsdf type="mask">{opacity}{furs}</bsdf>"#),
        format!(r#"<bsdf type="blendbsdf">{weight}{furs}{metal}</bsdf>"#),
        format!(r#"<bsdf type="blendbsdf">{weight}{dark}{furs}</bsdf>"#),
        format!(r#"<bsdf type="normalmap">{tilt}{furs}</bsdf>"#),
    ];
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("tuft.txt");
    let curve = |i: u32| -> String {
        let point = |k: u32| {
            let (i, k) = (f64::from(i), f64::from(k));
            let (x, z) = (0.1 * i - 1.2 + 0.1 * (k + i).sin(), 1.5 - 0.1 * k);
            format!("{x} {} {z} {}\n", 0.25 * k - 0.2, 0.03)
        };
        (0..6).map(point).collect::<String>() + "\n"
    };
    std::fs::write(&file, (0..25).map(curve).collect::<String>()).unwrap();
    let tuft = |plugin: &str, x: f64, bsdf: &str| {
        format!(
            r#"<shape type="{plugin}"><string name="filename" value="{}"/>
               <transform name="to_world"><translate x="{x}"/></transform>{bsdf}</shape>"#,
            file.display()
        )
    };
    let tufts = tuft("bsplinecurve", 0.0, &furs) + &tuft("linearcurve", 0.05, &dark);
    let case = rows("strands", &balls, &plates);
    let body = format!("{}{tufts}", case.body);
    let scene = scene(&body);
    (Case { body, ..case }, scene)
}

/// Masks, blends and tilted surfaces of most kinds, and some of what has no kind.
fn composites() -> Case {
    let metal = r#"<bsdf type="roughconductor"><string name="distribution" value="ggx"/><float name="alpha" value="0.2"/></bsdf>"#;
    let brushed = r#"<bsdf type="roughconductor"><float name="alpha" value="0.3"/><string name="material" value="Cu"/></bsdf>"#;
    let red = r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.2, 0.1"/></bsdf>"#;
    let glass = r#"<bsdf type="dielectric"/>"#;
    let frosted = r#"<bsdf type="roughdielectric"><float name="alpha" value="0.3"/></bsdf>"#;
    let plastic = r#"<bsdf type="plastic"/>"#;
    let lacquer = r#"<bsdf type="roughplastic"><float name="alpha" value="0.1"/></bsdf>"#;
    let mirror = r#"<bsdf type="conductor"/>"#;
    let both = |a: &str, b: &str| format!(r#"<bsdf type="twosided">{a}{b}</bsdf>"#);
    let mask = |inner: &str| {
        let opacity = squares("opacity", [0.0, 0.7]);
        format!(r#"<bsdf type="mask">{opacity}{inner}</bsdf>"#)
    };
    let blend = |a: &str, b: &str| {
        let weight = squares("weight", [0.3, 1.0]);
        format!(r#"<bsdf type="blendbsdf">{weight}{a}{b}</bsdf>"#)
    };
    let tilted = |inner: &str, more: &str| {
        format!(
            r#"<bsdf type="normalmap">{more}<texture name="normalmap" {SQUARES}<rgb name="color0" value="0.9, 0.4, 0.7"/>
            <rgb name="color1" value="0.42, 0.55, 0.9"/></texture>{inner}</bsdf>"#
        )
    };
    let corrected = r#"<boolean name="flip_invalid_normals" value="true"/><boolean name="use_shadowing_function" value="true"/>"#;
    let balls = [
        mask(red),
        mask(glass),
        blend(metal, brushed),
        blend(glass, frosted),
        blend(plastic, mirror),
        tilted(lacquer, ""),
        tilted(frosted, corrected),
        tilted(plastic, corrected),
    ];
    let plates = [
        mask(&both(metal, "")),
        both(&blend(red, lacquer), ""),
        both(mirror, &blend(metal, red)),
        tilted(&both(brushed, ""), ""),
        both(&tilted(metal, corrected), red),
        blend(&mask(red), metal),
        mask(frosted),
    ];
    rows("composites", &balls, &plates)
}

/// Meshes of so many triangles that there is a hierarchy: with and without normals and texture coordinates, with some that are
/// zero or all the same, and turned around.
fn rings() -> (Case, Scene) {
    let dir = tempfile::tempdir().unwrap();
    let ring = |k: u32, [normals, coordinates, odd]: [bool; 3], more: &str, bsdf: &str| {
        let (around, across) = (14, 9);
        let mut text = String::new();
        let angle = |i: u32, n: u32| std::f64::consts::TAU * f64::from(i) / f64::from(n);
        for (i, j) in (0..around).flat_map(|i| (0..across).map(move |j| (i, j))) {
            let ((y, x), (t, s)) = (angle(i, around).sin_cos(), angle(j, across).sin_cos());
            let r = 0.4 + 0.15 * s;
            text += &format!("v {} {} {}\n", r * x, r * y, 0.15 * t);
            let gone = odd && i % 3 == 0;
            let [nx, ny, nz] = if gone { [0.0; 3] } else { [s * x, s * y, t] };
            let [u, v] = if odd && j > 3 {
                [0.5; 2]
            } else {
                [
                    f64::from(i) / f64::from(around),
                    f64::from(j) / f64::from(across),
                ]
            };
            text += &format!("vn {nx} {ny} {nz}\nvt {u} {v}\n");
        }
        let corner = |i: u32, j: u32| {
            let at = (i % around) * across + j % across + 1;
            match (coordinates, normals) {
                (true, true) => format!("{at}/{at}/{at}"),
                (true, false) => format!("{at}/{at}"),
                (false, true) => format!("{at}//{at}"),
                (false, false) => format!("{at}"),
            }
        };
        for (i, j) in (0..around).flat_map(|i| (0..across).map(move |j| (i, j))) {
            let [a, b] = [corner(i, j), corner(i + 1, j)];
            let [c, d] = [corner(i + 1, j + 1), corner(i, j + 1)];
            text += &format!("f {a} {b} {c} {d}\n");
        }
        let file = dir.path().join(format!("{k}.obj"));
        std::fs::write(&file, text).unwrap();
        let (x, y) = (1.1 * f64::from(k % 3) - 1.1, 1.1 * f64::from(k / 3) - 0.3);
        format!(
            r#"<shape type="obj"><string name="filename" value="{}"/>{more}
               <transform name="to_world"><rotate x="1" y="0.4" angle="{}"/><translate x="{x}" y="{y}"/></transform>{bsdf}</shape>"#,
            file.display(),
            25 * k
        )
    };
    let brushed = r#"<bsdf type="roughconductor"><float name="alpha_u" value="0.05"/><float name="alpha_v" value="0.4"/></bsdf>"#;
    let both = format!(r#"<bsdf type="twosided">{brushed}</bsdf>"#);
    let print = format!(
        r#"<bsdf type="twosided"><bsdf type="diffuse"><texture name="reflectance" {SQUARES}<rgb name="color0" value="0.8, 0.3, 0.1"/>
           <rgb name="color1" value="0.1, 0.5, 0.7"/></texture></bsdf></bsdf>"#
    );
    let flat = r#"<boolean name="face_normals" value="true"/>"#;
    let turned = r#"<boolean name="flip_normals" value="true"/>"#;
    let meshes = [
        ring(0, [true, true, false], "", brushed),
        ring(1, [false, true, false], flat, &both),
        ring(2, [true, false, false], "", &both),
        ring(3, [true, true, false], turned, &both),
        ring(4, [true, true, true], "", &print),
        ring(5, [false, false, false], "", &print),
    ];
    let case = rows("rings", &[], &[]);
    let body = format!("{}{}", case.body, meshes.concat());
    let scene = scene(&body);
    (Case { body, ..case }, scene)
}

/// The cabinet, where all indices have become others than those of the file.
fn denser() -> (Case, Scene) {
    let case = Case {
        name: "denser",
        ..cabinet(1e-2)
    };
    let mut scene = scene(&case.body);
    let mut values = scene.params().values().to_vec();
    for p in scene.params().infos() {
        if p.name.ends_with(".eta.value") {
            p.range().for_each(|i| values[i] *= 1.07);
        }
    }
    scene.set_params(&values).expect("indices in their range");
    (case, scene)
}

fn all() -> impl Iterator<Item = (Case, Scene)> {
    let cases = cases::all()
        .into_iter()
        .chain([room(), lamps(), cabinet(1e-2), composites()])
        .chain(lenses());
    let read = cases.map(|case| {
        let scene = scene(&case.body);
        (case, scene)
    });
    read.chain([court(), bumps(), instances()])
}

/// Asserts that waves find what single paths do, bit by bit.
fn assert_same(what: &str, s: &Scene, settings: &Settings, techniques: &[Estimator]) {
    let theta = Theta::constant(s.params().values());
    let (seed, spp) = (3, 8);
    for &estimator in techniques {
        let single = match estimator {
            Estimator::Detached => single::<f32, BsdfOnly<Detached>>,
            Estimator::Emitter => single::<f32, EmitterOnly<Detached>>,
            _ => single::<f32, DetachedMis>,
        };
        let expected = single(s, &theta, settings, seed, spp).swap_remove(0);
        assert!(expected.iter().any(|x| *x > 0.0) || estimator != Estimator::Mis);
        let r = render_f32(&Job::new(s, settings, seed, 0..spp, &()), &theta, estimator);
        assert_eq!(r.non_finite.count, 0);
        assert!(r.sums[0] == expected, "{what} {estimator:?} {settings:?}");
    }
}

#[test]
fn images_are_those_of_single_paths_bit_by_bit() {
    use Estimator::{Detached, Emitter, Mis};
    // So smooth that derivatives in roughness are rounding, but images are not.
    let smooth = cabinet(1e-4);
    let lights = [("beacons", 1), ("more beacons", 5), ("most beacons", 15)];
    let lights = lights.map(|(name, more)| beacons(name, more));
    let more = [smooth, principles(), leaves()].into_iter().chain(lights);
    let more = more.map(|case| {
        let scene = scene(&case.body);
        (case, scene)
    });
    let rest = [strands(), denser(), rings(), pictures()];
    for (case, mut s) in all().chain(more).chain(rest).chain(lit()) {
        let plain = s.settings;
        assert_same(case.name, &s, &plain, &[Mis, Detached, Emitter]);
        for points in [Points::Sobol, Points::Antithetic] {
            let settings = Settings { points, ..plain };
            assert_same(case.name, &s, &settings, &[Mis]);
        }
        let lights = LightChoice::All;
        let all = Settings { lights, ..plain };
        assert_same(case.name, &s, &all, &[Mis, Emitter]);
        assert!(auto::guide(&mut s, &plain, 1, &()), "{}", case.name);
        assert_same(case.name, &s, &plain, &[Mis, Detached]);
    }
}

#[test]
fn images_of_the_scenes_of_the_repository_are_those_of_single_paths() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/scenes");
    let options = LoadOptions {
        defines: vec![("res".into(), "12".into())],
        ..LoadOptions::default()
    };
    let mut found = 0;
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("a file").path();
        if path.extension().is_none_or(|e| e != "xml") {
            continue;
        }
        let (scene, warnings) = Scene::load(&path, &options).expect("a scene");
        let name = path.display().to_string();
        assert!(warnings.is_empty(), "{name}: {warnings:?}");
        let mis = [Estimator::Mis];
        assert_same(&name, &scene, &scene.settings, &mis);
        found += 1;
    }
    assert!(found >= 10);
}

/// Where the noise of pixels is asked for, single paths find it.
#[test]
fn gradients_are_those_of_single_paths() {
    for (case, mut s) in all().chain([pictures()]) {
        let plain = s.settings;
        let names = [
            "mis",
            "detached",
            "emitter",
            "differential-mis",
            "differential",
            "attached-naive",
            "attached-mis-naive",
            "reparameterised",
            "reparameterised-mis",
            "mis-attached-weights",
            "differential-mis-attached-weights",
        ];
        for name in names {
            assert_same_gradients(case.name, &s, &plain, name);
        }
        let all = Settings {
            lights: LightChoice::All,
            ..plain
        };
        let particles = Settings {
            caustics: Caustics::Particles,
            ..plain
        };
        for settings in [all, particles] {
            for name in ["differential-mis", "attached-mis-naive"] {
                assert_same_gradients(case.name, &s, &settings, name);
            }
        }
        assert!(auto::guide(&mut s, &plain, 1, &()), "{}", case.name);
        assert_same_gradients(case.name, &s, &plain, "differential-mis");
    }
}

fn assert_same_gradients(what: &str, s: &Scene, settings: &Settings, name: &str) {
    let estimator = Estimator::from_name(name).expect("a known name");
    let theta = Theta::constant(s.params().values());
    let adjoint: Vec<f32> = (mean_adjoint(s).iter().zip(0..))
        .map(|(a, i)| a * (1.0 + (i % 5) as f32))
        .collect();
    let gradient = |active: &Active| {
        let g = estimator.backward_f32(
            &Job::new(s, settings, 4, 0..16, &()),
            &theta,
            active,
            &adjoint,
        );
        let g = g.expect("a gradient");
        assert_eq!(g.non_finite.count, 0);
        g.values
    };
    // Waves add in another order. Of samples of both signs, by the index of glass of roughness 0.01 and by shares of what is
    // mixed, 3e-5 is left of that.
    let signs = [".eta.value", ".opacity.", ".weight."];
    let tolerance = |param: &str| {
        if signs.iter().any(|part| param.contains(part)) {
            1e-4
        } else {
            1e-5
        }
    };
    // All together, and each alone: what no derivative needs is left out.
    let names: Vec<String> = smooth_params(s).into_iter().map(|p| p.name).collect();
    if estimator.capabilities().modes.double {
        assert_same_in_double_precision(what, s, settings, &names, &adjoint);
    }
    let sets = [names.clone()].into_iter();
    for names in sets.chain(names.into_iter().map(|n| vec![n])) {
        let active = Active::new(s, &names).expect("known names");
        let waves = gradient(&active);
        let single = gradient(&active.clone().with_noise(s, &[]));
        for ((param, a), b) in names.iter().zip(&waves).zip(&single) {
            let largest = b.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
            for (a, b) in a.iter().zip(b) {
                let same = (a - b).abs() <= tolerance(param) * largest;
                assert!(same, "{what} {name} {param} {settings:?}: {a} {b}");
            }
        }
    }
}

/// What differs in single precision is rounding.
fn assert_same_in_double_precision(
    what: &str,
    s: &Scene,
    settings: &Settings,
    names: &[String],
    adjoint: &[f32],
) {
    let values = values::<f64>(s);
    let theta = Theta::constant(&values);
    let gradient = |active: &Active| {
        let g = backward_f64(
            &Job::new(s, settings, 4, 0..16, &()),
            &theta,
            active,
            adjoint,
        );
        g.expect("a gradient").values
    };
    let active = Active::new(s, names).expect("known names");
    let waves = gradient(&active);
    let single = gradient(&active.clone().with_noise(s, &[]));
    for ((param, a), b) in names.iter().zip(&waves).zip(&single) {
        let largest = b.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        for (a, b) in a.iter().zip(b) {
            let same = (a - b).abs() <= 1e-10 * largest;
            assert!(same, "{what} {param} {settings:?}: {a} {b}");
        }
    }
}

/// In forward mode, images are made of what waves keep.
#[test]
fn derivative_images_are_those_of_single_paths() {
    for (case, mut s) in all() {
        let plain = s.settings;
        let lights = LightChoice::All;
        for settings in [plain, Settings { lights, ..plain }] {
            assert_same_tangents(case.name, &s, &settings);
        }
        assert!(auto::guide(&mut s, &plain, 1, &()), "{}", case.name);
        assert_same_tangents(case.name, &s, &plain);
    }
}

fn assert_same_tangents(what: &str, s: &Scene, settings: &Settings) {
    type Pair = Mis<Differential, Detached, DetachedWeights>;
    type Weighed = Mis<Detached, Detached, AttachedWeights>;
    type PairWeighed = Mis<Differential, Detached, AttachedWeights>;
    type Slowed = Mis<Reparameterised, Detached, AttachedWeights>;
    type Moved = Mis<AttachedDirect, Detached, AttachedWeights>;
    type Single = fn(&Scene, &Theta<Dual<f32, 1>>, &Settings, u64, u64) -> Vec<Vec<f64>>;
    let estimators: [(&str, Single); 9] = [
        ("mis", single::<_, DetachedMis>),
        ("detached", single::<_, BsdfOnly<Detached>>),
        ("emitter", single::<_, EmitterOnly<Detached>>),
        ("differential", single::<_, BsdfOnly<Differential>>),
        ("differential-mis", single::<_, Pair>),
        ("mis-attached-weights", single::<_, Weighed>),
        (
            "differential-mis-attached-weights",
            single::<_, PairWeighed>,
        ),
        ("reparameterised-mis", single::<_, Slowed>),
        ("attached-mis-naive", single::<_, Moved>),
    ];
    let (seed, spp) = (5, 2);
    let params = s.params();
    // All together, and each alone: where nothing moves, nothing is differentiated.
    let names: Vec<String> = smooth_params(s).into_iter().map(|p| p.name).collect();
    let sets = [names.clone()].into_iter();
    for names in sets.chain(names.into_iter().map(|n| vec![n])) {
        let along: Vec<_> = names
            .iter()
            .map(|n| Direction::uniform(params, n))
            .collect();
        let along: Vec<_> = along.into_iter().map(|d| d.expect("a name")).collect();
        let mut tangents = vec![Tangent::None; params.infos().len()];
        for name in &names {
            let param = params.handle(params.find(name).expect("a name"));
            tangents[param.id as usize] = Tangent::Uniform(Dual::new(0.0, [1.0]));
        }
        let theta = Theta::with_tangents(params.values(), &tangents);
        for (name, single) in estimators {
            let estimator = Estimator::from_name(name).expect("a known name");
            let values = params.values();
            let found =
                estimator.forward_f32(&Job::new(s, settings, seed, 0..spp, &()), values, &along);
            let found = found.expect("an image");
            assert_eq!(found.non_finite.count, 0);
            let expected = single(s, &theta, settings, seed, spp);
            for (k, (found, expected)) in found.sums.iter().zip(&expected).enumerate() {
                let largest = expected.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
                for (a, b) in found.iter().zip(expected) {
                    let same = (a - b).abs() <= 1e-4 * largest;
                    assert!(same, "{what} {name} {names:?} {k} {settings:?}: {a} {b}");
                }
            }
        }
    }
}
