//! Parameters that are found from pictures.

use clap::Parser;
use examples::cli::Outcome;
use examples::progress::Interrupt;
use examples::tools::recover;
use render::image_io::{read_rgb, write_exr};
use render::scene::LoadOptions;
use render::{Image, Scene};

use crate::{Folder, GLASS, SCENE, WALL, back_to_back, bytes, fails};

/// How bright a picture is does not decide whether Adam moves; where plain gradient descent does not, it says so.
#[test]
fn dim_scenes_are_recovered_like_bright_ones() {
    let dir = Folder::new();
    let dim = SCENE.replace("10,8,6", "1e-5,8e-6,6e-6");
    std::fs::write(dir.path("dim.xml"), dim).unwrap();
    dir.ok(
        "render",
        "dim.xml -o photo.exr --spp 512 --seed 9 -D red=0.3",
    );
    let job = format!("dim.xml --param {WALL} --target photo.exr --loss l2 -D red=0.6 --spp 4");
    let out = dir.run("recover", &format!("{job} --iterations 150 --out adam"));
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{stderr}");
    assert!(!stderr.contains("no unknown has moved"), "{stderr}");
    let report = dir.json("adam/result.json");
    for (c, truth) in [0.3, 0.4, 0.2].into_iter().enumerate() {
        let found = report["params"][format!("{WALL}[{c}]")]["value"]
            .as_f64()
            .unwrap();
        assert!((found / truth - 1.0).abs() < 0.02, "{c}: {found}");
    }
    let sgd = format!("{job} --iterations 12 --optimizer sgd --out sgd");
    let out = dir.run("recover", &sgd);
    let stderr = String::from_utf8_lossy(&out.stderr);
    let warning = "in 10 steps of sgd at --lr 1: its steps are --lr times the derivative";
    assert_eq!(stderr.matches(warning).count(), 1, "{stderr}");
}

/// Ctrl-C while the pictures are made, or just before, costs pictures and nothing else.
#[test]
fn an_interrupted_recovery_lacks_pictures_that_resuming_makes() {
    let dir = Folder::new();
    dir.ok("render", "scene.xml -o photo.exr --spp 16");
    let run = |out: &str, more: &str, interrupt: &Interrupt| {
        let [scene, photo, out] = ["scene.xml", "photo.exr", out].map(|n| dir.path(n));
        let mut args = vec!["recover".into(), scene.into_os_string()];
        args.extend(["--target".into(), photo.into_os_string()]);
        args.extend(["--out".into(), out.into_os_string()]);
        args.extend(["--param", WALL].map(Into::into));
        args.extend(more.split_whitespace().map(Into::into));
        recover::run(&recover::Args::try_parse_from(args).unwrap(), interrupt).unwrap()
    };
    let (quiet, pressed) = (Interrupt::default(), Interrupt::default());
    pressed.set();
    let exists = |name: &str| dir.path(name).exists();
    let pictures = ["before.exr", "after.exr", "before-after-target.png"];

    let job = "--iterations 3 --spp 2";
    assert_eq!(run("whole", job, &quiet), Outcome::Done);
    // A folder that another job has used.
    std::fs::create_dir(dir.path("parts")).unwrap();
    for name in pictures {
        std::fs::write(dir.path("parts").join(name), "of another job").unwrap();
    }
    assert_eq!(run("parts", job, &pressed), Outcome::Interrupted);
    assert_eq!(dir.json("parts/result.json")["iterations"], 0);
    assert!(exists("parts/target.exr") && exists("parts/iterations.csv"));
    assert!(!pictures.iter().any(|p| exists(&format!("parts/{p}"))));
    assert_eq!(run("parts", "--resume", &quiet), Outcome::Done);
    let same = || {
        for file in pictures.iter().chain(&["checkpoint.json", "result.json"]) {
            let [whole, parts] = ["whole", "parts"].map(|d| bytes(dir.path(d).join(file)));
            assert!(whole == parts, "{file}");
        }
    };
    same();
    // Nothing has moved: the pictures still show the values.
    assert_eq!(run("parts", "--resume", &pressed), Outcome::Interrupted);
    same();

    let long = "--iterations 1000000 --spp 1";
    run("long", &format!("{long} --stop-after 1"), &quiet);
    assert!(pictures.iter().all(|p| exists(&format!("long/{p}"))));
    let mut wait = std::time::Duration::from_millis(50);
    while dir.json("long/checkpoint.json")["iteration"] == 1 {
        wait *= 2;
        let late = Interrupt::default();
        std::thread::scope(|s| {
            s.spawn(|| {
                std::thread::sleep(wait);
                late.set();
            });
            assert_eq!(run("long", "--resume", &late), Outcome::Interrupted);
        });
    }
    assert_eq!(
        pictures.map(|p| exists(&format!("long/{p}"))),
        [true, false, false]
    );
}

#[test]
fn a_colour_is_recovered_from_a_picture() {
    let dir = Folder::new();
    dir.ok(
        "render",
        "scene.xml -o photo.exr --spp 512 --seed 9 -D red=0.3",
    );
    let unknown = format!("scene.xml --param {WALL} --target photo.exr");
    let steps = "--iterations 150 --spp 4 --out found";
    for optimizer in [
        "--optimizer adam",
        "--optimizer sgd --lr 2",
        "--optimizer gauss-newton",
    ] {
        dir.ok(
            "recover",
            &format!("{unknown} {steps} {optimizer} -D red=0.6"),
        );
        let report = dir.json("found/result.json");
        for (c, truth) in [0.3, 0.4, 0.2].into_iter().enumerate() {
            let found = report["params"][format!("{WALL}[{c}]")]["value"]
                .as_f64()
                .unwrap();
            assert!(
                (found / truth - 1.0).abs() < 0.02,
                "{optimizer} {c}: {found}"
            );
        }
        assert_eq!(report["scene"], "scene.xml");
        assert!(dir.path("found/values.svg").is_file());
    }
}

/// A floor that is lit through a ball of glass by a bulb alone: without connections nothing is seen of what it throws.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn a_floor_under_glass_is_recovered_by_connections() {
    let dir = Folder::new();
    let text = r#"<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="4"/></integrator>
        <sensor type="perspective"><float name="fov" value="20"/>
        <transform name="to_world"><lookat origin="0, 2, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="12"/></film></sensor>
        <shape type="rectangle"><bsdf type="diffuse" id="floor"><rgb name="reflectance" value="$floor"/></bsdf>
        <transform name="to_world"><scale value="2"/><rotate x="1" angle="-90"/></transform></shape>
        <shape type="sphere"><float name="radius" value="0.5"/><bsdf type="dielectric" id="glass"/></shape>
        <emitter type="point"><point name="position" value="0.5, 3, -1"/></emitter></scene>"#;
    std::fs::write(dir.path("floor.xml"), text).unwrap();
    dir.ok(
        "render",
        "floor.xml -o photo.exr --spp 256 --manifold sms --seed 9 -D floor=0.6,0.4,0.2",
    );
    let args = "floor.xml --target photo.exr --param floor.reflectance.value -D floor=0.3 --iterations 100 --spp 4";
    let half = dir.run(
        "recover",
        &format!("{args} --manifold sms --out found --stop-after 50"),
    );
    assert_eq!(half.status.code(), Some(130), "{half:?}");
    let resumed = dir.run("recover", "--out found --resume --manifold mnee");
    let message = String::from_utf8_lossy(&resumed.stderr).into_owned();
    assert!(
        message.contains("--manifold: expected \"sms\""),
        "{message}"
    );
    dir.ok("recover", "--out found --resume");
    let report = dir.json("found/result.json");
    for (c, truth) in [0.6, 0.4, 0.2].into_iter().enumerate() {
        let found = &report["params"][format!("floor.reflectance.value[{c}]")]["value"];
        let found = found.as_f64().unwrap();
        assert!((found / truth - 1.0).abs() < 0.03, "{c}: {found}");
    }
    // What moves chains, and second derivatives, are refused before anything is written.
    for (more, expected) in [
        (
            "--param glass.eta.value",
            "parameter `glass.eta.value` moves chains",
        ),
        ("--optimizer gauss-newton", "second derivatives"),
    ] {
        let refused = dir.run(
            "recover",
            &format!("{args} --manifold sms --out none {more}"),
        );
        let message = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(1), "{more}: {message}");
        assert!(message.contains(expected), "{more}: {message}");
        assert!(!dir.path("none").exists(), "{more}");
    }
}

/// Two walls behind each other's sensors, which see one of them each: only the sum over both views knows both colours.
#[test]
fn a_recovery_looks_through_several_sensors() {
    let dir = Folder::new();
    let truth = back_to_back(5.0, ["0.2,0.4,0.6", "0.7,0.3,0.1"]);
    std::fs::write(dir.path("truth.xml"), truth).unwrap();
    let start = back_to_back(5.0, ["0.5,0.5,0.5"; 2]);
    std::fs::write(dir.path("start.xml"), start).unwrap();
    dir.ok("render", "truth.xml -o front.exr --spp 256");
    dir.ok("render", "truth.xml -o back.exr --spp 256 --sensor back");
    let job = "start.xml --param near.reflectance.value --param far.reflectance.value --spp 4 --iterations 120";
    let views = "--target front=front.exr --target back=back.exr";
    let both = dir.run("recover", &format!("{job} {views} --out both"));
    let said = String::from_utf8_lossy(&both.stderr);
    // Neither is left out.
    assert!(
        both.status.success() && !said.contains("the first of"),
        "{said}"
    );
    let report = dir.json("both/result.json");
    for (wall, truth) in [("near", [0.2, 0.4, 0.6]), ("far", [0.7, 0.3, 0.1])] {
        for (c, truth) in truth.into_iter().enumerate() {
            let value = &report["params"][format!("{wall}.reflectance.value[{c}]")]["value"];
            let found = value.as_f64().unwrap();
            assert!((found - truth).abs() < 0.01, "{wall} {c}: {found}");
        }
    }
    for kind in ["before", "after", "target"] {
        for view in ["front", "back"] {
            assert!(dir.path(&format!("both/{kind}-{view}.exr")).is_file());
        }
    }
    // In parts it is the same run; one target is the first sensor's.
    let parts = format!("{job} --target front.exr --target 1=back.exr --out parts --stop-after 50");
    let out = dir.run("recover", &parts);
    assert_eq!(out.status.code(), Some(130));
    dir.ok("recover", "--out parts --resume");
    let found = |folder: &str| dir.json(&format!("{folder}/result.json"))["params"].clone();
    assert_eq!(found("parts"), found("both"));

    let unknown = format!("{job} --target side=back.exr --out none");
    let message = "--target: parameter `sensor`: expected a number below 2 or one of `front`, `back`, found `side`";
    fails(&dir, &unknown, message);
    fails(
        &dir,
        &format!("{job} --target back=front.exr --out none"),
        "12",
    );
}

/// The index of smooth glass moves a Dirac delta: for whole paths that move and for nothing else.
#[test]
fn the_index_of_smooth_glass_is_recovered() {
    let dir = Folder::new();
    std::fs::write(dir.path("glass.xml"), GLASS).unwrap();
    dir.ok("render", "glass.xml -o photo.exr --spp 512");
    let unknown = "glass.xml --param m.eta.value --target photo.exr -D eta=1.3 --out found";
    let detached = dir.run("recover", unknown);
    assert_eq!(detached.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&detached.stderr).contains("m.eta.value"));
    assert!(!dir.path("found").exists());

    let steps = "--iterations 100 --spp 16 --loss l2";
    dir.ok(
        "recover",
        &format!("{unknown} {steps} --estimator attached-path"),
    );
    let report = dir.json("found/result.json");
    let found = report["params"]["m.eta.value"]["value"].as_f64().unwrap();
    assert!((found / 1.5 - 1.0).abs() < 0.02, "{found}");
}

/// A tent before a lamp, whose points and colours are unknown.
const TENT: &str = r#"<scene version="3.0.0">
  <integrator type="path"><integer name="max_depth" value="3"/></integrator>
  <sensor type="perspective" id="eye"><float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="12"/><rfilter type="box"/></film>
  </sensor>
  <shape type="obj" id="it"><string name="filename" value="tent.obj"/>
    <bsdf type="diffuse" id="cloth"><texture name="reflectance" type="bitmap" id="weave">
      <string name="filename" value="weave.exr"/><boolean name="raw" value="true"/></texture></bsdf></shape>
  <emitter type="constant"><rgb name="radiance" value="1"/></emitter>
</scene>"#;

/// A ball and a post before a sky, seen through a lens that is focused on the ball.
const BLURRED: &str = r#"<scene version="3.0.0">
  <integrator type="path"><integer name="max_depth" value="2"/></integrator>
  <sensor type="thinlens"><float name="fov" value="40"/><float name="aperture_radius" value="0.4"/>
    <float name="focus_distance" value="4"/>
    <transform name="to_world"><lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="24"/><rfilter type="box"/></film>
  </sensor>
  <shape type="sphere" id="ball"><transform name="to_world"><scale value="0.6"/><translate x="0.3" z="1"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.8, 0.3, 0.2"/></bsdf></shape>
  <shape type="cube" id="post"><transform name="to_world"><scale x="0.2" y="3" z="0.2"/><translate x="-1" z="-2"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.5, 0.2"/></bsdf></shape>
  <emitter type="constant"><rgb name="radiance" value="1"/></emitter>
</scene>"#;

/// From one blurred picture: how far away a lens is focused, how wide it is, and where the camera stands, each from a start that
/// is off; and the scene that is written has them.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn lenses_are_recovered_from_a_blurred_picture() {
    let dir = Folder::new();
    std::fs::write(dir.path("blurred.xml"), BLURRED).unwrap();
    dir.ok("render", "blurred.xml --spp 1024 -o t.exr");
    let common = "blurred.xml --target t.exr --estimator edges --optimizer gauss-newton --spp 32 --iterations 12";
    let params =
        "--param sensor.focus_distance --param sensor.aperture_radius --param sensor.translation";
    let start = "-P sensor.focus_distance=5 -P sensor.aperture_radius=0.3 -P sensor.translation=0.15,-0.1,0.2";
    dir.ok("recover", &format!("{common} {params} {start} --out lens"));
    let found = dir.json("lens/result.json");
    let value = |name: &str| found["params"][name]["value"].as_f64().unwrap();
    for (name, expected, error) in [
        ("sensor.focus_distance", 4.0, 0.15),
        ("sensor.aperture_radius", 0.4, 0.02),
        ("sensor.translation[0]", 0.0, 0.02),
        ("sensor.translation[1]", 0.0, 0.02),
        ("sensor.translation[2]", 0.0, 0.06),
    ] {
        let found = value(name);
        assert!((found - expected).abs() < error, "{name}: {found}");
    }
    let written = std::fs::read_to_string(dir.path("lens/scene/scene.xml")).unwrap();
    let focus = format!(
        "name=\"focus_distance\" value=\"{}\"",
        value("sensor.focus_distance") as f32
    );
    assert!(written.contains(&focus), "{written}");
}

/// The scene [`TENT`] in a folder, whose mesh of 5 x 5 vertices has the middle one pulled by so much.
fn pitch(dir: &Folder, pulled: [f64; 2]) {
    std::fs::write(dir.path("tent.xml"), TENT).unwrap();
    let mut tent = String::new();
    for j in 0..5 {
        for i in 0..5 {
            let [u, v] = [i, j].map(|k| f64::from(k) / 4.0);
            let by = if i == 2 && j == 2 { pulled } else { [0.0; 2] };
            let [x, y] = [2.0 * u - 1.0 + by[0], 2.0 * v - 1.0 + by[1]];
            let z = 0.3 * (3.0 * u).sin();
            tent += &format!("v {x} {y} {z}\nvt {u} {v}\n");
        }
    }
    for a in (0..20).filter(|a| a % 5 < 4).map(|a| a + 1) {
        let b = a + 5;
        tent += &format!("f {a}/{a} {0}/{0} {1}/{1} {b}/{b}\n", a + 1, b + 1);
    }
    std::fs::write(dir.path("tent.obj"), tent).unwrap();
    let mut weave = Image::new(8, 8);
    weave
        .data
        .iter_mut()
        .enumerate()
        .for_each(|(i, x)| *x = 0.3 + 0.05 * (i % 7) as f32);
    write_exr(&dir.path("weave.exr"), &weave).unwrap();
    dir.ok("render", "tent.xml --spp 64 -o t.exr");
}

/// Points of a mesh and texels are recovered together, with options behind their keys, and written as a scene that has them
/// when it is read again: its mesh beside it. Cameras are, by Gauss-Newton steps.
#[test]
fn shapes_are_recovered_and_written() {
    let dir = Folder::new();
    pitch(&dir, [0.0; 2]);

    let common = "tent.xml --target t.exr --estimator edges --spp 2 --iterations 6";
    let points = "--param it.vertex_positions:smooth=4,lr=0.01";
    let texels = "--param cloth.reflectance.data:coarse=2";
    dir.ok(
        "recover",
        &format!("{common} {points} {texels} -P cloth.reflectance.data=0.5 --out d"),
    );
    assert!(dir.path("d/scene/meshes/it.obj").exists());
    let load = |name: &str| Scene::load(&dir.path(name), &LoadOptions::default()).unwrap();
    let [corners, weave] = ["it.vertex_positions", "cloth.reflectance.data"];
    let [(again, warnings), (before, _)] = ["d/scene/scene.xml", "tent.xml"].map(load);
    assert!(warnings.is_empty(), "{warnings:?}");
    let positions = |mut scene: Scene| {
        scene.make_movable(&[corners]).unwrap();
        scene.params().get(corners).unwrap().to_vec()
    };
    let found = read_rgb(&dir.path(&format!("d/{weave}.exr"))).unwrap();
    assert_eq!(again.params().get(weave).unwrap(), found.data);
    let (found, start) = (positions(again), positions(before));
    assert!(found.len() == 75 && found != start);
    let mean = found.iter().map(|&x| f64::from(x)).sum::<f64>() / 75.0;
    let report = dir.json("d/result.json");
    let known = report["params"][format!("mean of {corners}")]["value"].as_f64();
    assert!((mean - known.unwrap()).abs() < 1e-12, "{mean} {known:?}");
    assert!(report.get("folded").is_none());
    dir.ok("render", "d/scene/scene.xml --spp 4 -o again.exr");
    // Six steps of two texels along each side, then four, then eight: the checkpoint knows.
    dir.ok(
        "recover",
        &format!("{common} {texels} --stop-after 6 --out e"),
    );
    assert_eq!(
        dir.run("recover", "--resume --out e --iterations 6")
            .status
            .code(),
        Some(0)
    );

    for (option, needed) in [
        ("it.vertex_positions:coarse=2", "texels for coarse"),
        (
            "cloth.reflectance.data:smooth=2",
            "points of a mesh for smooth",
        ),
        (
            "it.vertex_positions:smooth=-1",
            "a positive number for smooth",
        ),
        ("it.vertex_positions:rough=1", "lr, smooth or coarse"),
    ] {
        let out = dir.run("recover", &format!("{common} --param {option} --out f"));
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert!(
            !out.status.success() && stderr.contains(needed),
            "{option}: {stderr}"
        );
    }

    let newton =
        "tent.xml --target t.exr --estimator edges --optimizer gauss-newton --spp 8 --iterations 3";
    dir.ok(
        "recover",
        &format!("{newton} --param sensor.translation -P sensor.translation=0.2,0,0 --out g"),
    );
    let found = dir.json("g/result.json");
    let x = found["params"]["sensor.translation[0]"]["value"]
        .as_f64()
        .unwrap();
    assert!(x.abs() < 0.2, "{x}");
}

/// Meshes that fold over themselves are reported, as they start and as they come to: on the way, and with the number of
/// triangles in the result, which is that of the mesh that is written.
#[test]
fn folds_are_reported() {
    let dir = Folder::new();
    let job = "tent.xml --target t.exr --estimator edges --spp 2 --iterations 1";
    let run = |lr: &str, out: &str| {
        let param = format!("--param it.vertex_positions:lr={lr}");
        let done = dir.run("recover", &format!("{job} {param} --out {out}"));
        let stderr = String::from_utf8_lossy(&done.stderr).into_owned();
        assert!(done.status.success(), "{stderr}");
        let path = dir.path(&format!("{out}/scene/scene.xml"));
        let (mut scene, _) = Scene::load(&path, &LoadOptions::default()).unwrap();
        scene.make_movable(&["it.vertex_positions"]).unwrap();
        let folded = scene.folded().first().map_or(0, |(_, count, _)| *count);
        let report = dir.json(&format!("{out}/result.json"));
        let said = report["folded"]["it"].as_u64();
        assert_eq!(said, (folded > 0).then_some(folded as u64), "{report}");
        let warnings = stderr.matches("`it` folds over itself");
        (folded, warnings.count(), stderr)
    };
    // Over its neighbour, half a unit away.
    pitch(&dir, [0.8, 0.1]);
    let (folded, warnings, stderr) = run("1e-4", "a");
    let message = format!("{folded} of 32 triangles are turned over; expected a mesh without");
    assert!((1..8).contains(&folded) && warnings == 1, "{stderr}");
    assert!(stderr.contains(&message), "{stderr}");
    pitch(&dir, [0.0; 2]);
    let (folded, warnings, stderr) = run("1e-4", "b");
    assert_eq!((folded, warnings), (0, 0), "{stderr}");
    // In one step.
    let (folded, warnings, stderr) = run("0.6", "c");
    assert!(folded > 0 && warnings == 1, "{stderr}");
    assert!(stderr.contains("expected a smaller lr"), "{stderr}");
}
