//! Images: how they are made, checked and set up.

use std::path::Path;
use std::process::Command;

use render::Image;
use render::image_io::read_rgb as read_exr;
use render::image_io::{read_labels, write_exr, write_exr_planes, write_png};
use serde_json::Value;

use crate::{Folder, GLASS, SCENE, WALL, bytes, keys, samples};

#[test]
fn render_writes_image_picture_and_report() {
    let dir = Folder::new();
    dir.ok("render", "scene.xml --json new/report.json");
    assert_eq!(dir.names(), ["new", "scene.exr", "scene.png", "scene.xml"]);
    let report = dir.json("new/report.json");
    assert_eq!(
        keys(&report),
        [
            "caustics",
            "height",
            "lights",
            "sampler",
            "scene",
            "seconds_load",
            "seconds_render",
            "spp",
            "threads",
            "width"
        ]
    );
    assert_eq!(report["scene"], "scene.xml");
    assert_eq!((&report["width"], &report["spp"]), (&36.into(), &8.into()));
    assert_eq!(samples(&report), ["sobol", "one", "paths"]);
    let image = read_exr(&dir.path("scene.exr")).unwrap();
    assert_eq!((image.width, image.height), (36, 24));
    assert!(bytes(dir.path("scene.png")).starts_with(b"\x89PNG"));
    let chosen = "--sampler antithetic --lights all --caustics particles";
    dir.ok("render", &format!("scene.xml {chosen} --json all.json"));
    assert_eq!(
        samples(&dir.json("all.json")),
        ["antithetic", "all", "particles"]
    );
    assert_eq!(dir.json("all.json")["pixels_per_particle"], 4);
    assert!(report.get("pixels_per_particle").is_none());
    // Options arrive.
    let mean = |args: &str| {
        dir.ok("render", &format!("scene.xml -o other.exr {args}"));
        read_exr(&dir.path("other.exr")).unwrap().mean()
    };
    assert_eq!(mean(""), image.mean());
    assert_ne!(mean("--seed 1"), image.mean());
    assert!(mean("-D red=0.1")[0] < image.mean()[0]);
    assert!(mean("--max-depth 1")[1] < mean("--max-depth 2")[1]);
    assert!(mean("--max-depth 2")[1] < mean("--max-depth -1")[1]);
}

/// A ball of glass on a floor under a lamp.
const GLASS_BALL: &str = r#"<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="5"/></integrator>
        <sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0, 3, 4" target="0, 0.2, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="12"/></film></sensor>
        <shape type="rectangle"><bsdf type="diffuse" id="floor"/>
        <transform name="to_world"><scale value="4"/><rotate x="1" angle="-90"/></transform></shape>
        <shape type="sphere"><point name="center" value="0, 0.9, 0"/><float name="radius" value="0.7"/>
        <bsdf type="dielectric" id="glass"/></shape>
        <shape type="rectangle"><transform name="to_world"><scale value="0.8"/><rotate x="1" angle="90"/><translate y="3"/>
        </transform><emitter type="area"/></shape></scene>"#;

/// That, with a bulb too, and both by integrators of others.
fn glass_balls() -> Folder {
    let dir = Folder::new();
    let point = r#"<emitter type="point" id="bulb"><point name="position" value="0, 3, 0"/></emitter></scene>"#;
    let bulb = GLASS_BALL.replace("</scene>", point);
    let by = |text: &str, integrator: &str| text.replace(r#"<integrator type="path">"#, integrator);
    let aimed = r#"<integrator type="path_sms_ss"><boolean name="mnee_init" value="true"/>"#;
    for (name, text) in [
        (
            "filtered.xml",
            by(GLASS_BALL, r#"<integrator type="path_filtered_ss">"#),
        ),
        ("aimed.xml", by(&bulb, aimed)),
        ("ball.xml", GLASS_BALL.into()),
        ("bulb.xml", bulb),
    ] {
        std::fs::write(dir.path(name), text).unwrap();
    }
    dir
}

/// Connections are reported, and checked against particles.
#[test]
fn manifold_connections_are_rendered_reported_and_checked() {
    let dir = glass_balls();
    dir.ok(
        "render",
        "ball.xml --manifold sms --spp 32 --manifold-check --manifold-picture rates.exr --json sms.json",
    );
    assert!(dir.path("rates.exr").exists());
    let report = dir.json("sms.json");
    let manifold = &report["manifold"];
    assert_eq!(
        (&manifold["method"], &manifold["unbiased"]),
        (&"sms".into(), &true.into())
    );
    let number = |key: &str| manifold[key].as_f64().unwrap();
    assert!(
        number("found") > 0.0
            && number("success_rate") > 0.0
            && number("trials_per_solution") >= 1.0
            && number("share_of_light") > 0.0
    );
    let check = &report["manifold_check"];
    let (z, limit) = (
        check["worst_z"].as_f64().unwrap(),
        check["limit_z"].as_f64().unwrap(),
    );
    assert!(z < limit, "{check}");
    dir.ok(
        "render",
        "ball.xml --manifold mnee --bounces 2 --spp 4 --json mnee.json",
    );
    assert_eq!(dir.json("mnee.json")["manifold"]["unbiased"], false);
    dir.ok(
        "render",
        "ball.xml --manifold mnee-unbiased --bounces 2 --spp 16 --json both.json",
    );
    let both = &dir.json("both.json")["manifold"];
    assert_eq!(both["unbiased"], true);
    assert!(
        both["paths_met"].as_u64() >= both["paths_counted"].as_u64(),
        "{both}"
    );
    dir.ok("render", "ball.xml --manifold off --spp 4 --json off.json");
    assert!(dir.json("off.json").get("manifold").is_none());
    // Chains that are named are left out: the rest of the image, which both halves have.
    let mean = |args: &str| {
        dir.ok("render", args);
        read_exr(&dir.path("x.exr")).unwrap().mean()[1]
    };
    let off = mean("ball.xml --manifold off --spp 32 -o x.exr");
    let rest = mean("ball.xml --manifold off --bounces 2 --spp 32 -o x.exr --json rest.json");
    assert_eq!(dir.json("rest.json")["manifold"]["method"], "left out");
    assert!(rest < off, "{rest} {off}");
    // Integrators of scene files that keep some of the light over casters say so.
    let filtered = mean("filtered.xml --spp 32 -o x.exr --json filtered.json");
    let report = &dir.json("filtered.json")["manifold"];
    assert_eq!(
        (&report["method"], &report["other_light"]),
        (&"paths".into(), &false.into())
    );
    assert!(filtered < off, "{filtered} {off}");
    // What is flagged and cannot be a caster is named.
    let flag = r#"<bsdf type="plastic"/><boolean name="caustic_caster_single" value="true"/>"#;
    let plastic = GLASS_BALL.replace(r#"<bsdf type="dielectric" id="glass"/>"#, flag);
    std::fs::write(
        dir.path("plastic.xml"),
        plastic.replace("\"sphere\"", "\"sphere\" id=\"lump\""),
    )
    .unwrap();
    let output = dir.run("render", "plastic.xml --manifold sms --spp 1");
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        output.status.success() && message.contains("`lump`: flagged as a caster"),
        "{message}"
    );
}

/// A scene file whose integrator leaves light out is said to show it after all, where options take that integrator's place.
#[test]
fn options_that_bring_more_light_than_the_file_say_so() {
    let dir = glass_balls();
    let says = |options: &str| {
        let output = dir.run("render", &format!("filtered.xml --spp 1 {options}"));
        assert!(output.status.success(), "{options}");
        String::from_utf8_lossy(&output.stderr)
            .contains("takes the place of the scene's integrator")
    };
    for options in ["--manifold sms", "--manifold off", "--integrator particle"] {
        assert!(says(options), "{options}");
    }
    for options in ["", "--manifold off --bounces 1"] {
        assert!(!says(options), "{options}");
    }
}

/// Files of images say of connections what reports do: that trials ran out, and that they are biased. Where nothing is connected
/// they say nothing.
#[test]
fn images_say_that_trials_ran_out() {
    let dir = glass_balls();
    let labels = |file: &str| read_labels(&dir.path(file)).unwrap();
    dir.ok("render", "ball.xml --spp 1 -o photo.exr");
    assert!(labels("photo.exr").is_empty());
    dir.ok("render", "ball.xml --manifold sms --spp 1 -o sms.exr");
    let found = labels("sms.exr");
    let expected = ["exhausted", "method", "unbiased"].map(|key| format!("manifold.{key}"));
    assert!(found.keys().eq(&expected), "{found:?}");
    assert!(found.values().eq(["0", "sms", "true"]), "{found:?}");

    let few = "--manifold sms --trials 1 --starts uniform";
    let ball = "ball.xml --param floor.reflectance.value";
    let (out, report) = (["image.exr", "d/floor.reflectance.value.exr"], "image.json");
    dir.ok(
        "render",
        &format!("ball.xml {few} --spp 4 -o {} --json {report}", out[0]),
    );
    let found = labels(out[0]);
    let exhausted = &dir.json(report)["manifold"]["exhausted"];
    assert_eq!(found["manifold.exhausted"], exhausted.to_string());
    dir.ok("gradient", &format!("{ball} {few} --spp 4 --images d"));
    dir.ok(
        "recover",
        &format!("{ball} {few} --spp 4 --iterations 1 --target photo.exr --out r"),
    );
    dir.ok(
        "compare",
        &format!("{ball} {few} --spp 4 --repeats 4 --estimators mis,mis-balance --out c"),
    );
    let of_compare = ["reference", "std.mis", "std.mis-balance"];
    let of_compare = of_compare.map(|kind| format!("c/floor.reflectance.value.{kind}.exr"));
    let others = ["r/before.exr", "r/after.exr"].map(str::to_owned);
    for file in (out.map(str::to_owned).iter())
        .chain(&others)
        .chain(&of_compare)
    {
        let found = labels(file);
        let number: u64 = found["manifold.exhausted"].parse().unwrap();
        let remark = format!("manifold (sms): biased, {number} ran out of trials");
        assert!(number > 0, "{file}: {found:?}");
        assert_eq!(found["manifold.unbiased"], "false", "{file}");
        assert_eq!(found["comments"], remark, "{file}");
    }
}

/// Options of connections are refused where they would have no effect, and parameters that move chains.
#[test]
fn manifold_options_without_effect_are_refused() {
    let dir = glass_balls();
    for (args, expected) in [
        ("ball.xml --trials 4", "--manifold"),
        (
            "ball.xml --manifold off --constraint angle",
            "without effect",
        ),
        ("ball.xml --manifold mnee --trials 4", "sms-biased"),
        ("ball.xml --manifold mnee-unbiased --trials 4", "sms-biased"),
        ("bulb.xml --manifold mnee-unbiased", "bulb.intensity.value"),
        ("aimed.xml", "bulb.intensity.value"),
        ("filtered.xml --manifold-check", "no connections to check"),
        ("filtered.xml --caustics particles", "--manifold off"),
        (
            "ball.xml --manifold sms --caustics particles",
            "one of them",
        ),
        (
            "ball.xml --manifold sms --integrator particle",
            "--integrator path",
        ),
        ("ball.xml --manifold sms --bounces 9", "1..=8"),
        ("ball.xml --manifold-check", "no connections to check"),
        (
            "ball.xml --manifold off --bounces 1 --manifold-check",
            "no connections to check",
        ),
        (
            "ball.xml --manifold-picture p.exr",
            "no connections to picture",
        ),
        (
            "ball.xml --manifold mnee --starts two-stage",
            "without effect",
        ),
        ("ball.xml --manifold off --starts uniform", "without effect"),
        ("ball.xml --manifold sms --caster-roughness 2", "[0, 1]"),
    ] {
        refuses(&dir, args, expected);
    }
    let output = dir.run(
        "gradient",
        "ball.xml --manifold sms --param glass.eta.value --estimator mis",
    );
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    let moved = "parameter `glass.eta.value` moves chains, which have derivatives only where they stay; expected `--manifold off`, \
                 and an estimator that sees it";
    assert!(
        !output.status.success() && message.contains(moved),
        "{message}"
    );
    let output = dir.run(
        "compare",
        "ball.xml --manifold sms --param glass.eta.value --out none",
    );
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        !output.status.success() && message.contains(moved),
        "{message}"
    );
}

/// Gradients, their comparison and recovery say what walks came to, as images do: that trials ran out, and that the result is
/// biased.
#[test]
fn derivatives_say_what_walks_came_to() {
    let dir = glass_balls();
    let param = "--param floor.reflectance.value";
    dir.ok("render", "ball.xml --spp 4 -o photo.exr");
    for (tool, args, report) in [
        (
            "gradient",
            format!("ball.xml {param} --spp 8 --repeats 2 --json g.json"),
            "g.json",
        ),
        (
            "compare",
            format!("ball.xml {param} --spp 8 --repeats 4 --estimators mis,mis-balance --out c"),
            "c/report.json",
        ),
        (
            "recover",
            format!("ball.xml {param} --spp 4 --iterations 3 --target photo.exr --out r"),
            "r/result.json",
        ),
    ] {
        dir.ok(tool, &format!("{args} --manifold sms"));
        let found = &dir.json(report)["manifold"];
        assert_eq!(
            (&found["method"], &found["unbiased"], &found["exhausted"]),
            (&"sms".into(), &true.into(), &0.into()),
            "{tool}"
        );
        assert!(found["walks"].as_u64().unwrap() > 0, "{tool}: {found}");
        let again = args
            .replace("--out ", "--out few-")
            .replace("g.json", "few-g.json");
        let few = dir.run(
            tool,
            &format!("{again} --manifold sms --trials 1 --starts uniform"),
        );
        let message = String::from_utf8_lossy(&few.stderr).into_owned();
        assert!(
            few.status.success() && message.contains("connections ran out of trials"),
            "{tool}: {message}"
        );
        let found = &dir.json(&format!("few-{report}"))["manifold"];
        assert_eq!(found["unbiased"], false, "{tool}: {found}");
        assert!(found["exhausted"].as_u64().unwrap() > 0, "{tool}: {found}");
        // Without connections there is nothing to say.
        let off = args
            .replace("--out ", "--out off-")
            .replace("g.json", "off-g.json");
        dir.ok(tool, &off);
        assert!(dir.json(&format!("off-{report}")).get("manifold").is_none());
    }
}

#[test]
fn glints_are_rendered_reported_and_refused() {
    let dir = Folder::new();
    let mut map = Image::new(8, 8);
    for (i, texel) in map.data.chunks_exact_mut(3).enumerate() {
        let (x, y) = ((i % 8) as f32, (i / 8) as f32);
        let wave = |x: f32| 0.5 + 0.05 * (0.8 * x).sin();
        texel.copy_from_slice(&[wave(x), wave(y), 1.0]);
    }
    write_exr(&dir.path("map.exr"), &map).unwrap();
    let scene = |metal: &str| {
        format!(
            r#"<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="3"/></integrator>
            <sensor type="perspective"><float name="fov" value="40"/>
            <transform name="to_world"><lookat origin="0, 3, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
            <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="12"/></film></sensor>
            <shape type="rectangle">{metal}
            <transform name="to_world"><scale value="2"/><rotate x="1" angle="-90"/></transform></shape>
            <emitter type="point"><point name="position" value="0, 3, -4"/></emitter></scene>"#
        )
    };
    let mapped = r#"<bsdf type="normalmap" id="map"><string name="filename" value="map.exr"/>
        <bsdf type="conductor" id="metal"/></bsdf>"#;
    std::fs::write(dir.path("metal.xml"), scene(mapped)).unwrap();
    std::fs::write(dir.path("matt.xml"), scene(r#"<bsdf type="diffuse"/>"#)).unwrap();
    dir.ok(
        "render",
        "metal.xml --glints unbiased --spp 8 --json a.json -o a.exr",
    );
    let report = &dir.json("a.json")["glints"];
    assert_eq!(report["unbiased"], true);
    assert!(report["found"].as_u64().unwrap() > 0, "{report}");
    assert!(report["trials_per_solution"].as_f64().unwrap() >= 1.0);
    assert!(read_exr(&dir.path("a.exr")).unwrap().mean()[1] > 0.0);
    dir.ok(
        "render",
        "metal.xml --glints biased --glint-trials 8 --glint-region footprint --glint-weights lobe --spp 4 --json b.json",
    );
    assert_eq!(dir.json("b.json")["glints"]["unbiased"], false);
    let labels = read_labels(&dir.path("metal.exr")).unwrap();
    assert_eq!(labels["comments"], "glints (biased, 8 walks): biased");
    dir.ok("render", "metal.xml --glints off --spp 4 --json off.json");
    assert!(dir.json("off.json").get("glints").is_none());
    for (args, expected) in [
        ("matt.xml --glints unbiased", "no shape of the scene"),
        ("metal.xml --glint-trials 4", "--glints"),
        ("metal.xml --glints off --glint-trials 4", "without effect"),
        (
            "metal.xml --glints unbiased --integrator particle",
            "--integrator path",
        ),
    ] {
        refuses(&dir, args, expected);
    }
    let gradient = |parameter: &str| {
        dir.run(
            "gradient",
            &format!("metal.xml --glints unbiased --param {parameter} --estimator mis --spp 4 --repeats 2"),
        )
    };
    let refused = gradient("map.normalmap.data");
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        !refused.status.success() && message.contains("map.normalmap.data"),
        "{message}"
    );
    let output = gradient("metal.specular_reflectance.value");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

#[test]
fn strategies_agree_on_the_mean() {
    let dir = Folder::new();
    let mean = |args: &str| {
        dir.ok("render", &format!("scene.xml -o a.exr --spp 256 {args}"));
        read_exr(&dir.path("a.exr")).unwrap().mean()[1]
    };
    let expected = mean("");
    for args in [
        "--heuristic balance",
        "--strategy emitter",
        "--strategy bsdf",
    ] {
        let relative = mean(args) / expected - 1.0;
        // 0 is far from all: BSDF sampling, the worst, has a standard error of 0.2 %.
        assert!(
            relative.abs() < 0.01 && relative != 0.0,
            "{args}: {relative}"
        );
    }
}

#[cfg(unix)]
#[test]
fn images_are_written_through_links_and_left_overs_removed() {
    let dir = Folder::new();
    std::os::unix::fs::symlink("target.exr", dir.path("link.exr")).unwrap();
    std::os::unix::fs::symlink("scene.xml", dir.path("own.exr")).unwrap();
    std::fs::write(dir.path(".target.exr.1-0.tmp"), "of a run that was killed").unwrap();
    dir.ok("render", "scene.xml --spp 1 -o link.exr");
    assert!(dir.path("link.exr").is_symlink());
    assert!(read_exr(&dir.path("target.exr")).is_ok());
    assert!(!dir.path(".target.exr.1-0.tmp").exists());
    let out = dir.run("render", "scene.xml --spp 1 -o own.exr");
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(stderr.contains("one that is read"), "{stderr}");
    assert_eq!(bytes(dir.path("scene.xml")), SCENE.as_bytes());
}

/// What of a scene is understood, line by line, and an exit code that says whether it would render.
#[test]
fn a_check_says_what_is_understood() {
    let dir = Folder::new();
    let check = |text: &str| {
        std::fs::write(dir.path("checked.xml"), text).unwrap();
        let json = dir.path("found.json");
        let output = Command::new(env!("CARGO_BIN_EXE_render"))
            .arg(dir.path("checked.xml"))
            .args(["--check", "--json"])
            .arg(&json)
            .output()
            .unwrap();
        let report: Value = serde_json::from_slice(&std::fs::read(json).unwrap()).unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        (output.status.code(), text, report)
    };
    let expect = |scene: &str, code: i32, outcome: &str, said: &str| {
        let (found, text, report) = check(scene);
        assert_eq!(
            (found, report["outcome"].as_str()),
            (Some(code), Some(outcome)),
            "{text}"
        );
        assert!(text.contains(said), "{text}");
        (text, report)
    };
    let said = "understood       3  shape `rectangle`: 14, 15, 19";
    expect(SCENE, 0, "renders", said);
    let wall = SCENE.replace(
        "<bsdf type=\"diffuse\" id=\"wall\">",
        "<bsdf type=\"polarizer\" id=\"wall\">",
    );
    let said = "refused         13  bsdf `polarizer`: polarisation is not there";
    let (text, report) = expect(&wall, 1, "refused", said);
    assert!(text.starts_with(said), "{text}");
    assert_eq!(report["findings"][0]["line"], 13);
    let texture = "<texture type=\"bitmap\" name=\"reflectance\"><string name=\"filename\" value=\"none.png\"/></texture>";
    let wall = SCENE.replace(
        "<rgb name=\"reflectance\" value=\"$red,0.4,0.2\"/>",
        texture,
    );
    let said = "missing         13  `filename`: expected an existing file";
    expect(&wall, 1, "incomplete", said);
    let wall_without_image = wall;
    expect(&SCENE.replace("fov", "fow"), 1, "wrong", "");
    // Nothing else is done.
    assert!(!Path::new("checked.exr").exists());
    // What is understood is said however the file is written, and beside what is refused before any plugin is made.
    let smoke = "<medium type=\"homogeneous\" id=\"smoke\"/>";
    let foggy = SCENE.replace("<bsdf type", &format!("{smoke}<bsdf type"));
    let foggy = foggy.replace(
        "<shape type=\"rectangle\">\n",
        "<shape type=\"rectangle\"><ref name=\"interior\" id=\"smoke\"/>\n",
    );
    for scene in [foggy.clone(), foggy.replace('\n', " ")] {
        let (text, _) = expect(
            &scene,
            1,
            "refused",
            "medium `homogeneous`: participating media are not there",
        );
        for part in [
            "film `hdrfilm`",
            "rfilter `box`",
            "sampler `independent`",
            "sensor `perspective`",
            "emitter `area`",
            "bsdf `diffuse`",
            "shape `rectangle`",
        ] {
            let said = text
                .lines()
                .any(|l| l.starts_with("understood") && l.contains(part));
            assert!(said, "{part}: {text}");
        }
    }
    // Textures that may be missing are as good as others, as where the scene is rendered; values of parameters are tried.
    std::fs::write(dir.path("scene.xml"), &wall_without_image).unwrap();
    for (args, code) in [
        ("scene.xml --check", 1),
        ("scene.xml --check --allow-missing", 0),
        ("scene.xml --spp 1 --allow-missing", 0),
        (
            "scene.xml --check --allow-missing -P wall.reflectance=0.2",
            0,
        ),
        ("scene.xml --check --allow-missing -P wall.reflectance=2", 1),
    ] {
        let output = dir.run("render", args);
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{args}: {error}");
    }
}

/// Any parameter may be set, by its own name, by that of Mitsuba 3 or by a pattern, to numbers or to an image.
#[test]
fn parameters_are_set_on_the_command_line() {
    let dir = Folder::new();
    let list = |args: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_gradient"))
            .arg(dir.path("scene.xml"))
            .arg("--list")
            .args(args)
            .current_dir(&dir.0)
            .output()
            .unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let error = String::from_utf8(output.stderr).unwrap();
        (output.status.code(), text, error)
    };
    let value = |args: &[&str], name: &str| {
        let (code, text, error) = list(args);
        assert_eq!(code, Some(0), "{error}");
        let line = text
            .lines()
            .find(|l| l.starts_with(name))
            .map(str::to_owned);
        line.unwrap_or_else(|| panic!("{text}"))
    };
    assert!(value(&[], WALL).contains("[0.7, 0.4, 0.2]  also Rectangle.bsdf.reflectance.value"));
    for key in [
        WALL,
        "Rectangle_1.bsdf.reflectance",
        "wall.*",
        "Rect*.reflectance.value",
    ] {
        assert!(
            value(&["-P", &format!("{key}=0.25")], WALL).contains("[0.25, 0.25, 0.25]"),
            "{key}"
        );
        let three = format!("{key}=0.1, 0.2 0.3");
        assert!(
            value(&["-P", &three], WALL).contains("[0.1, 0.2, 0.3]"),
            "{key}"
        );
    }
    for (argument, expected) in [
        ("wall.reflectence=0.2", "closest: wall.reflectance.value"),
        (
            "wall.reflectance=1.5",
            "expected a value in [0, 1], found 1.5",
        ),
        ("wall.reflectance=0.1,0.2", "expected one or three numbers"),
        ("wall.reflectance=a.exr", "expected one or three numbers"),
        ("*.alpha=1", "no parameter `*.alpha`"),
    ] {
        let (code, _, error) = list(&["-P", argument]);
        assert!(
            code == Some(1) && error.contains(expected),
            "{argument}: {error}"
        );
    }
    // Matrices are read and set, row by row.
    let lamp = value(&[], "lamp.to_world");
    assert!(
        lamp.contains("4 x 4") && lamp.contains("0.3,0,0,0.5,0,-0.3,0,0,0,0,-0.3,1.5,0,0,0,1"),
        "{lamp}"
    );
    let moved = "0.3,0,0,0.25,0,-0.3,0,0,0,0,-0.3,1.5,0,0,0,1";
    let argument = format!("lamp.to_world={moved}");
    assert!(value(&["-P", &argument], "lamp.to_world").contains(moved));
    assert!(value(&["-P", &argument], "lamp.translation").contains("[-0.25, 0.0, 0.0]"));
    for (argument, expected) in [
        ("lamp.to_world=1,2", "16"),
        ("lamp.to_world=a.exr", "expected 16 numbers"),
        (
            "lamp.to_world=1,0,0,0,0,1,0,0,0,0,2,0,0,0,0,1",
            "scales axes unequally",
        ),
    ] {
        let (code, _, error) = list(&["-P", argument]);
        assert!(
            code == Some(1) && error.contains(expected) && error.contains("lamp.to_world"),
            "{argument}: {error}"
        );
    }
    // Texels take an image of their size.
    let image = |width: usize, value: f32| Image {
        width,
        height: 1,
        data: vec![value; 3 * width],
    };
    write_exr(&dir.path("own.exr"), &image(2, 0.5)).unwrap();
    write_exr(&dir.path("new.exr"), &image(2, 0.75)).unwrap();
    write_exr(&dir.path("wide.exr"), &image(3, 0.75)).unwrap();
    let texture = "<texture type=\"bitmap\" name=\"reflectance\"><string name=\"filename\" value=\"own.exr\"/></texture>";
    let wall = SCENE.replace(
        "<rgb name=\"reflectance\" value=\"$red,0.4,0.2\"/>",
        texture,
    );
    std::fs::write(dir.path("scene.xml"), wall).unwrap();
    let texels = "wall.reflectance.data";
    assert!(value(&[], texels).contains("mean 0.500000"));
    assert!(value(&["-P", "wall.reflectance=new.exr"], texels).contains("mean 0.750000"));
    assert!(value(&["-P", "wall.reflectance=0.1"], texels).contains("mean 0.100000"));
    let (code, _, error) = list(&["-P", "wall.reflectance=wide.exr"]);
    assert!(
        code == Some(1)
            && error.contains("an image of 2 x 1, as the scene has it, found one of 3 x 1"),
        "{error}"
    );
    // With or without the ending of names.
    assert!(value(&["-P", "*.reflectance=0.2"], texels).contains("mean 0.200000"));
    // A colour is replaced by an image in the scene file only, and the answer says how.
    let (code, _, error) = list(&["-P", "lamp.emitter.radiance=new.exr"]);
    let how = "<texture type=\"bitmap\" name=\"radiance\"><string name=\"filename\" value=\"new.exr\"/></texture>";
    assert!(code == Some(1) && error.contains(how), "{error}");
    // Mitsuba's name of the angle of view is of the sensor's id or class.
    for key in ["sensor.x_fov", "PerspectiveCamera.x_fov", "sensor0.x_fov"] {
        assert!(
            value(&["-P", &format!("{key}=50")], "sensor.fov").contains("[50"),
            "{key}"
        );
    }
}

/// Images for parameters are decoded as the scene's own are, and may be layers.
#[test]
fn images_of_parameters_are_decoded_as_the_scene_says() {
    let dir = Folder::new();
    let grey = |value: f32| Image {
        width: 2,
        height: 2,
        data: vec![value; 12],
    };
    // 0.5 linear is 188 of 255 on the curve.
    write_png(&dir.path("grey.png"), &grey(0.5), 0.0).unwrap();
    let layered: Vec<(String, Vec<f32>)> = ["AO", "Diffuse"]
        .iter()
        .zip([0.25, 0.75])
        .flat_map(|(layer, x)| ["R", "G", "B"].map(|c| (format!("{layer}.{c}"), vec![x; 4])))
        .collect();
    let layered = layered
        .iter()
        .map(|(name, data)| (name.as_str(), data.clone()))
        .collect();
    write_exr_planes(&dir.path("layers.exr"), 2, 2, layered).unwrap();
    let texture = |name: &str, raw: bool| {
        format!(
            "<texture type=\"bitmap\" name=\"{name}\"><string name=\"filename\" value=\"grey.png\"/>\
             <boolean name=\"raw\" value=\"{raw}\"/></texture>"
        )
    };
    let mean = |scene: &str, key: &str, image: &str| {
        std::fs::write(dir.path("scene.xml"), scene).unwrap();
        let argument = format!("{key}={image}");
        let output = Command::new(env!("CARGO_BIN_EXE_gradient"))
            .arg(dir.path("scene.xml"))
            .args(["--list", "-P", &argument])
            .current_dir(&dir.0)
            .output()
            .unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let line = text.lines().find(|l| l.starts_with(key)).map(str::to_owned);
        let error = String::from_utf8_lossy(&output.stderr);
        let line = line.unwrap_or_else(|| panic!("{key}: {error}"));
        let (_, number) = line.split_once("mean ").unwrap_or_else(|| panic!("{line}"));
        number
            .split_whitespace()
            .next()
            .unwrap()
            .parse::<f64>()
            .unwrap()
    };
    let constant = "<rgb name=\"reflectance\" value=\"$red,0.4,0.2\"/>";
    let coloured = |raw: bool| SCENE.replace(constant, &texture("reflectance", raw));
    let rough = |raw: bool| {
        let alpha = texture("alpha", raw);
        SCENE
            .replace(
                "<bsdf type=\"diffuse\" id=\"wall\">",
                "<bsdf type=\"roughconductor\" id=\"wall\">",
            )
            .replace(constant, &alpha)
    };
    let bumped = format!(
        "<bsdf type=\"normalmap\" id=\"wall\">{}<bsdf type=\"diffuse\"/></bsdf>",
        texture("normalmap", true)
    );
    let mapped = SCENE.replace(
        &format!("<bsdf type=\"diffuse\" id=\"wall\">{constant}</bsdf>"),
        &bumped,
    );
    let (linear, encoded) = (0.5, 188.0 / 255.0);
    for (scene, key, expected) in [
        (coloured(false), "wall.reflectance.data", linear),
        (coloured(true), "wall.reflectance.data", encoded),
        (rough(false), "wall.alpha.data", linear),
        (rough(true), "wall.alpha.data", encoded),
        (mapped, "wall.normalmap.data", encoded),
    ] {
        let found = mean(&scene, key, "grey.png");
        assert!((found - expected).abs() < 5e-3, "{key}: {found} {expected}");
    }
    for (layer, expected) in [("AO", 0.25), ("Diffuse", 0.75)] {
        let found = mean(
            &coloured(false),
            "wall.reflectance.data",
            &format!("layers.exr:{layer}"),
        );
        assert!((found - expected).abs() < 1e-5, "{layer}: {found}");
    }
    // So are targets.
    std::fs::write(
        dir.path("scene.xml"),
        SCENE
            .replace("value=\"36\"", "value=\"2\"")
            .replace("value=\"24\"", "value=\"2\""),
    )
    .unwrap();
    let target = |layer: &str| {
        let args = format!(
            "scene.xml --param {WALL} --loss l2 --target layers.exr{layer} --spp 1 --json out.json"
        );
        dir.run("gradient", &args)
    };
    let refused = target("");
    let error = String::from_utf8_lossy(&refused.stderr);
    assert!(
        !refused.status.success() && error.contains("FILE.EXR:LAYER"),
        "{error}"
    );
    let [dark, light] = [":AO", ":Diffuse"].map(|layer| {
        let output = target(layer);
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        dir.json("out.json")["loss"].to_string()
    });
    assert_ne!(dark, light);
}

/// What particles cannot show is said, and is there by density estimation.
#[test]
fn particles_say_what_they_leave_dark() {
    let dir = Folder::new();
    std::fs::write(dir.path("glass.xml"), GLASS).unwrap();
    let of = |scene: &str, integrator: &str| {
        let args = format!("{scene} -o a.exr --spp 16 --integrator {integrator}");
        let out = dir.run("render", &args);
        let stderr = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(out.status.success(), "{args}: {stderr}");
        let image = read_exr(&dir.path("a.exr")).unwrap();
        let at = image.height / 2 * image.width + image.width / 2;
        (stderr, image.data[3 * at])
    };
    let (said, middle) = of("glass.xml", "particle");
    assert!(said.contains("by `ball` is dark"), "{said}");
    assert_eq!(middle, 0.0);
    let (said, middle) = of("glass.xml", "density --radius 0.1");
    assert!(!said.contains("dark") && middle > 0.1, "{said} {middle}");
    let (said, _) = of("scene.xml", "particle");
    assert!(!said.contains("dark"), "{said}");
}

/// Asserts that `render` refuses these arguments, in these words, and leaves no image.
fn refuses(dir: &Folder, args: &str, expected: &str) {
    let output = dir.run("render", &format!("{args} -o refused.exr"));
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        !output.status.success() && message.contains(expected),
        "{args}: {message}"
    );
    assert!(!dir.path("refused.exr").exists(), "{args}");
}

/// What a technique cannot show is said, where something is missing for that reason.
#[test]
fn what_is_missing_in_an_image_is_said() {
    let dir = Folder::new();
    let with = |name: &str, more: &str| {
        std::fs::write(
            dir.path(name),
            SCENE.replace("</scene>", &format!("{more}</scene>")),
        )
        .unwrap();
    };
    with("point.xml", r#"<emitter type="point"/>"#);
    with(
        "holes.xml",
        r#"<shape type="sphere" id="net"><bsdf type="mask"><bsdf type="diffuse"/></bsdf></shape>"#,
    );
    let dark = SCENE.replace(
        r#"<emitter type="area"><rgb name="radiance" value="10,8,6"/></emitter>"#,
        "",
    );
    std::fs::write(dir.path("dark.xml"), dark).unwrap();
    let unmet = "1 of 2 emitters bring nothing";
    let holes = "what the camera sees by `net` is dark";
    let gradient = format!("--param {WALL} --estimator");
    for (tool, args, warning, expected) in [
        ("render", "point.xml", unmet, false),
        ("render", "point.xml --strategy bsdf", unmet, true),
        (
            "render",
            "scene.xml --strategy bsdf",
            "bring nothing",
            false,
        ),
        (
            "gradient",
            &*format!("point.xml {gradient} detached"),
            unmet,
            true,
        ),
        (
            "gradient",
            &*format!("point.xml {gradient} mis"),
            unmet,
            false,
        ),
        ("render", "holes.xml --integrator particle", holes, true),
        ("render", "holes.xml", holes, false),
        (
            "render",
            "scene.xml --integrator particle",
            "is dark",
            false,
        ),
        ("render", "dark.xml", "dark.xml: there is no emitter", true),
        ("render", "scene.xml", "there is no emitter", false),
    ] {
        let out = dir.run(tool, &format!("{args} --spp 1"));
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.success(), "{tool} {args}: {stderr}");
        assert_eq!(
            stderr.contains(warning),
            expected,
            "{tool} {args}: {stderr}"
        );
    }
}
