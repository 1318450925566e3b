//! Estimators against each other, and where they fail.

use serde_json::Value;

use crate::{Folder, LAMP, SCENE, WALL, bytes, samples};

#[test]
fn estimators_are_compared_and_the_numbers_depend_on_the_seed_alone() {
    let dir = Folder::new();
    let names = "mis,detached,differential-mis,attached,attached-naive";
    let args = format!("scene.xml --param {WALL} --estimators {names} --spp 4 --repeats 6");
    dir.ok("compare", &format!("{args} --out a --threads 1"));
    dir.ok(
        "compare",
        &format!("{args} --out b --threads 3 --json b.json"),
    );
    let (a, b) = (dir.json("a/report.json"), dir.json("b/report.json"));
    assert_eq!(dir.json("b.json"), b);
    assert_eq!(samples(&a), ["sobol", "one", "paths"]);
    let rows = |v: &Value| v["rows"].as_array().unwrap().clone();
    assert_eq!(rows(&a).len(), 4);
    for (a, b) in rows(&a).iter().zip(&rows(&b)) {
        for key in ["estimator", "mean", "z", "z_block", "variance", "finding"] {
            assert_eq!(a[key], b[key], "{key}");
        }
        assert!(a["efficiency"].as_f64().unwrap() > 0.0);
    }
    assert_eq!(rows(&a)[0]["finding"], "right");
    let refused = a["refused"].as_array().unwrap();
    assert_eq!(refused.len(), 1);
    assert!(
        refused[0]["reason"]
            .as_str()
            .unwrap()
            .contains("discontinuities")
    );
    for file in ["table.csv", "ladder.csv", "verdict.txt"] {
        assert!(dir.path("a").join(file).exists(), "{file}");
    }
    let chart = format!("{WALL}.error.svg");
    assert!(dir.path("a").join(chart).exists());
    assert!(dir.path("a").join(format!("{WALL}.std.mis.exr")).exists());

    let out = dir.run(
        "compare",
        &format!("scene.xml --param {WALL} --estimators best"),
    );
    assert_eq!(out.status.code(), Some(1));
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(
        stderr.contains("`best`; known: auto, mis-f64, ") && stderr.contains("differential-mis"),
        "{stderr}"
    );
}

#[test]
fn estimators_that_never_meet_the_light_are_not_called_biased() {
    let dir = Folder::new();
    let tiny = SCENE.replace(r#"<scale value="0.3"/>"#, r#"<scale value="2e-4"/>"#);
    let tiny = tiny.replace("10,8,6", "1e7,8e6,6e6");
    std::fs::write(dir.path("tiny.xml"), tiny).unwrap();
    let args = format!("--param {LAMP} --estimators mis,detached --spp 4 --repeats 6 --out a");
    dir.ok("compare", &format!("tiny.xml {args}"));
    let report = dir.json("a/report.json");
    let rows = report["rows"].as_array().unwrap().iter();
    let findings: Vec<_> = rows.map(|r| r["finding"].as_str().unwrap()).collect();
    assert_eq!(findings, ["right", "unresolved"]);
    let verdict = String::from_utf8(bytes(dir.path("a").join("verdict.txt"))).unwrap();
    assert!(
        verdict.contains("unresolved: detached") && !verdict.contains("biased:"),
        "{verdict}"
    );
}

/// Against a reference that is wrong, a right estimator differs and differs again; finite differences are not wrong
/// by their step.
#[test]
fn differences_are_looked_at_twice_and_steps_are_no_bias() {
    let dir = Folder::new();
    let metal =
        r#"<bsdf type="roughconductor" id="metal"><float name="alpha" value="0.3"/></bsdf>"#;
    let shiny = SCENE.replace(
        r#"<shape type="rectangle"><ref id="wall"/></shape>"#,
        &format!(r#"<shape type="rectangle">{metal}</shape>"#),
    );
    std::fs::write(dir.path("shiny.xml"), shiny).unwrap();
    let args =
        "--param metal.alpha.value --estimators mis,attached-naive --reference attached-naive";
    dir.ok("compare", &format!("shiny.xml {args} --spp 64 --out a"));
    let rows = dir.json("a/report.json")["rows"].clone();
    assert_eq!(rows[0]["finding"], "biased", "{rows}");
    assert_eq!(rows[1]["finding"], "right", "{rows}");
    let verdict = String::from_utf8(bytes(dir.path("a").join("verdict.txt"))).unwrap();
    assert!(verdict.contains("again so with four times"), "{verdict}");

    // A mirror: differences of a hundredth of the normal are off by three.
    let mirror = r#"<bsdf type="normalmap" id="wall"><texture name="normalmap" type="checkerboard">
            <rgb name="color0" value="0.6, 0.45, 0.95"/><rgb name="color1" value="0.48, 0.55, 0.98"/></texture>
        <bsdf type="conductor"/></bsdf>
        <emitter type="vmf"><vector name="direction" value="0.1, -0.2, 1"/><float name="kappa" value="12"/></emitter>"#;
    let start = SCENE.split("<bsdf").next().unwrap();
    let wall = r#"<shape type="rectangle"><ref id="wall"/></shape></scene>"#;
    std::fs::write(dir.path("mirror.xml"), format!("{start}{mirror}{wall}")).unwrap();
    let args =
        "--param wall.normalmap.color0.value --estimators attached-path --reference fd --out b";
    dir.ok("compare", &format!("mirror.xml {args}"));
    let report = dir.json("b/report.json");
    assert_eq!(report["rows"][0]["finding"], "right", "{report}");
    assert!(report["rows"][0]["mean"][0].as_f64().unwrap().abs() > 0.01);

    // Nobody left is a mistake.
    let refused = dir.run(
        "compare",
        &args
            .replace("attached-path", "mis,detached")
            .replace("--param", "mirror.xml --param"),
    );
    assert_eq!(refused.status.code(), Some(1));
}

/// Where nothing else is asked for, the reference is an estimator that sees what moves; one that does not is refused by name.
/// What is biased says why.
#[test]
fn references_see_what_moves() {
    let dir = Folder::new();
    let wall = r#"<shape type="rectangle"><ref id="wall"/>"#;
    let moves = SCENE.replace(wall, &wall.replace("rectangle\"", "rectangle\" id=\"it\""));
    assert_ne!(moves, SCENE);
    std::fs::write(dir.path("moves.xml"), moves).unwrap();
    let args = "moves.xml --param it.translation --estimators edges,interior --spp 4 --repeats 4";
    dir.ok("compare", &format!("{args} --out a"));
    let report = dir.json("a/report.json");
    assert_eq!(report["reference"], "edges");
    assert_eq!(report["rows"].as_array().unwrap().len(), 2);
    let out = dir.run("compare", &format!("{args} --reference mis --out b"));
    assert_eq!(out.status.code(), Some(1));
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(
        stderr.contains("--reference mis: ") && stderr.contains("it.translation"),
        "{stderr}"
    );
    for (estimator, warns) in [("interior", true), ("edges", false)] {
        let args = format!("moves.xml --param it.translation --spp 4 --estimator {estimator}");
        let out = dir.run("gradient", &args);
        assert_eq!(out.status.code(), Some(0));
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert_eq!(
            stderr.contains("`interior` is biased on purpose") && stderr.contains("F10"),
            warns,
            "{stderr}"
        );
    }
}

/// Differences of images whose scene moves are a reference for what moves: shapes, lights and cameras, in units of their own.
/// The unbiased estimators agree with them as with `edges`, and boundaries that are left out are noticed. 64 repeats of the
/// differences, 16 of 64 samples per pixel of each estimator, significance 1e-3 over all blocks and estimators.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn differences_are_a_reference_for_what_moves() {
    let dir = Folder::new();
    let ball = r#"<shape type="sphere" id="ball"><transform name="to_world"><scale value="0.3"/><translate z="0.8"/>
        </transform><ref id="wall"/></shape></scene>"#;
    let text = SCENE.replace("</scene>", ball);
    let small = text.replace("\"36\"", "\"12\"").replace("\"24\"", "\"8\"");
    assert_ne!(small, text);
    std::fs::write(dir.path("moves.xml"), small).unwrap();
    for (param, most) in [
        ("ball.translation", 0.06),
        ("ball.scale", 0.2),
        ("sensor.rotation", 0.2),
        ("lamp.translation", 0.06),
    ] {
        let args = format!(
            "moves.xml --param {param} --estimators edges,reparameterised-mis,interior --spp 64 --repeats 16"
        );
        dir.ok("compare", &format!("{args} --reference fd --out fd"));
        dir.ok("compare", &format!("{args} --out own"));
        let [fd, own] = ["fd", "own"].map(|out| dir.json(&format!("{out}/report.json")));
        assert_eq!([&fd["reference"], &own["reference"]], ["fd", "edges"]);
        let findings = |report: &Value| {
            let rows = report["rows"].as_array().unwrap().iter();
            let found = rows.map(|r| r["finding"].as_str().unwrap().to_owned());
            found.collect::<Vec<String>>()
        };
        assert_eq!(findings(&fd), ["right", "right", "biased"], "{param}: {fd}");
        // Edges are so certain that what a kernel blurs may be seen.
        let [edges, follows, interior] = &findings(&own)[..] else {
            panic!("{param}: {own}");
        };
        assert_eq!([edges, interior], ["right", "biased"], "{param}: {own}");
        assert_ne!(follows, "biased", "{param}: {own}");
        assert_eq!(own["steps"].as_array().unwrap().len(), 0);
        let step = fd["steps"][0][1].as_f64().unwrap();
        assert_eq!(fd["steps"][0][0], param);
        assert!(step > 0.0 && step <= 1.001 * most, "{param}: {step}");
        let verdict = String::from_utf8(bytes(dir.path("fd").join("verdict.txt"))).unwrap();
        assert!(verdict.contains("differences of steps"), "{verdict}");
    }
}

#[test]
fn failures_of_estimators_are_marked_and_depend_on_the_seed_alone() {
    let dir = Folder::new();
    let names = "emitter,detached,attached,attached-naive,differential-mis";
    let args = format!("--quick --estimators {names}");
    dir.ok("stability", &format!("{args} --out a --threads 1"));
    dir.ok(
        "stability",
        &format!("{args} --out b --threads 3 --json b.json"),
    );
    let (a, b) = (dir.json("a/report.json"), dir.json("b/report.json"));
    assert_eq!(dir.json("b.json"), b);
    let rows = |v: &Value| v["rows"].as_array().unwrap().clone();
    assert_eq!(rows(&a).len(), rows(&b).len());
    let mut biased = 0;
    for (a, b) in rows(&a).iter().zip(&rows(&b)) {
        for key in ["sweep", "x", "estimator", "mean", "z", "std", "finding"] {
            assert_eq!(a[key], b[key], "{key}");
        }
        assert_eq!(a["non_finite"], 0);
        if a["finding"] == "biased" {
            assert_eq!(a["estimator"], "attached-naive", "{a}");
            biased += 1;
        }
    }
    assert!(biased > 0);
    // The law of roughness: 2 / alpha.
    let smooth = rows(&a).into_iter().find(|r| {
        r["sweep"] == "roughness-beckmann" && r["estimator"] == "detached" && r["x"] == 1e-4
    });
    let std = smooth.unwrap()["std"].as_f64().unwrap();
    assert!((std / 2e4 - 1.0).abs() < 0.2, "{std}");
    for file in [
        "points.csv",
        "verdict.txt",
        "stability.png",
        "stability.svg",
    ] {
        assert!(!bytes(dir.path("a").join(file)).is_empty(), "{file}");
    }
    let verdict = String::from_utf8(bytes(dir.path("a").join("verdict.txt"))).unwrap();
    for mode in ["F1:", "F2:", "F8, F10", "F40:"] {
        assert!(verdict.contains(mode), "{mode} not in:\n{verdict}");
    }
    // What `mis` alone says is left out without it.
    assert!(!verdict.contains("a limit of length"), "{verdict}");
    let out = dir.run("stability", "--estimators best");
    assert_eq!(out.status.code(), Some(1));
}

/// Edges are right however things move; what has no term for them, or forgets that rays start from what moves, is marked
/// where that matters.
#[test]
fn failures_of_what_moves_are_marked() {
    let dir = Folder::new();
    dir.ok(
        "stability",
        "--quick --estimators edges,interior,biased-rays,reparameterised-mis,reparameterised-exact --out a",
    );
    let report = dir.json("a/report.json");
    let all = report["rows"].as_array().unwrap();
    let moving = || all.iter().filter(|r| r["param"] != "metal.alpha.value");
    let mut outlines = 0;
    for r in moving() {
        let (sweep, x) = (r["sweep"].as_str().unwrap(), r["x"].as_f64().unwrap());
        let right = match r["estimator"].as_str().unwrap() {
            // What is smaller than a pixel is met by edges alone.
            "reparameterised-exact" if r["finding"] == "unresolved" => continue,
            "edges" | "reparameterised-exact" => true,
            "interior" => sweep == "bounces",
            "biased-rays" => sweep != "bounces" || x == 2.0,
            _ => continue,
        };
        let expected = if right { "right" } else { "biased" };
        assert_eq!(r["finding"], expected, "{r}");
        outlines += usize::from(!right);
    }
    assert!(outlines > 8, "{report}");
    for file in ["motion.png", "motion.svg", "stability.png"] {
        assert!(!bytes(dir.path("a").join(file)).is_empty(), "{file}");
    }
    let verdict = String::from_utf8(bytes(dir.path("a").join("verdict.txt"))).unwrap();
    assert!(verdict.contains("F44: biased-rays: biased"), "{verdict}");
}

/// Alone, without a scene; beside anything else it is refused.
#[test]
fn estimators_are_listed_with_what_they_refuse() {
    let dir = Folder::new();
    for tool in ["compare", "gradient", "recover", "stability"] {
        let out = dir.command(tool, "--list-estimators").output().unwrap();
        assert!(
            out.status.success(),
            "{tool}: {}",
            String::from_utf8_lossy(&out.stderr)
        );
        let text = String::from_utf8(out.stdout).unwrap();
        for e in render::instances::Estimator::ALL {
            let row = format!(
                "{}\n    {}\n    {}\n",
                e.name(),
                e.summary(),
                e.capabilities()
            );
            assert!(text.contains(&row), "{tool}: no {row}in\n{text}");
            for refusal in e.capabilities().refusals() {
                assert!(text.contains(&refusal.to_string()), "{tool}: {refusal}");
            }
        }
        assert!(
            text.contains("positions of shapes") && text.contains("cameras"),
            "{text}"
        );
        let out = dir
            .command(tool, "--list-estimators --seed 1")
            .output()
            .unwrap();
        assert_eq!(out.status.code(), Some(2), "{tool}");
    }
}
