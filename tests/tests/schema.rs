//! The schema of scene files has every plugin and every attribute that scenes of tests have, and no other names.

use std::collections::{BTreeMap, BTreeSet};

use render::Scene;
use render::bsdf::Material;
use render::emitter::AnyEmitter;
use render::shape::AnyShape;
use roxmltree::{Document, Node};
use tests::cases;

/// Names of attributes by the element and the type of a plugin, and the elements that it may have inside.
type Patterns = BTreeMap<(String, String), (BTreeSet<String>, BTreeSet<String>)>;

fn patterns(schema: &Document) -> Patterns {
    let mut all = Patterns::new();
    for define in schema.descendants().filter(|n| n.has_tag_name("define")) {
        let name = define.attribute("name").expect("a name");
        let Some((tag, plugin)) = name.split_once('.') else {
            continue;
        };
        let values = define.descendants().filter(|n| n.has_tag_name("value"));
        let names = values.filter_map(|n| n.text()).skip(1).map(str::to_owned);
        let inside = define.descendants().filter(|n| n.has_tag_name("ref"));
        let inside = inside
            .filter_map(|n| n.attribute("name"))
            .map(str::to_owned);
        let pattern = (names.collect(), inside.collect());
        all.insert((tag.to_owned(), plugin.to_owned()), pattern);
    }
    all
}

const PLUGINS: [&str; 9] = [
    "bsdf",
    "emitter",
    "film",
    "integrator",
    "rfilter",
    "sampler",
    "sensor",
    "shape",
    "texture",
];

fn check(node: Node, patterns: &Patterns, whole: &str) {
    for part in node.children().filter(Node::is_element) {
        let tag = part.tag_name().name();
        if PLUGINS.contains(&tag) {
            check(part, patterns, whole);
        }
        if node.has_tag_name("scene") || tag == "ref" {
            continue;
        }
        let key = (
            node.tag_name().name().to_owned(),
            node.attribute("type").expect("a type").to_owned(),
        );
        let (names, inside) = &patterns[&key];
        let known = part.attribute("name").is_some_and(|n| names.contains(n));
        assert!(known || inside.contains(tag), "{key:?}: {part:?}\n{whole}");
    }
}

#[test]
fn the_schema_knows_what_scenes_have() {
    let text = Scene::schema();
    let schema = Document::parse(&text).unwrap_or_else(|e| panic!("{e}\n{text}"));
    let patterns = patterns(&schema);
    for (tag, plugins) in [
        ("bsdf", Material::PLUGINS),
        ("emitter", AnyEmitter::PLUGINS),
        ("shape", AnyShape::PLUGINS),
    ] {
        for plugin in plugins.concat() {
            let key = (tag.to_owned(), plugin.to_owned());
            assert!(patterns.contains_key(&key), "{key:?}");
        }
    }
    // All that is referred to is there.
    let defined: BTreeSet<_> = schema
        .descendants()
        .filter(|n| n.has_tag_name("define"))
        .filter_map(|n| n.attribute("name"))
        .collect();
    for reference in schema.descendants().filter(|n| n.has_tag_name("ref")) {
        let name = reference.attribute("name").expect("a name");
        assert!(defined.contains(name), "{name}");
    }
    for case in cases::all() {
        let whole = format!("<scene version=\"3.0.0\">{}</scene>", case.body);
        let scene = Document::parse(&whole).unwrap_or_else(|e| panic!("{e}\n{whole}"));
        check(scene.root_element(), &patterns, &whole);
    }
    for (tag, plugin, name) in [
        ("bsdf", "roughconductor", "alpha_v"),
        ("bsdf", "normalmap", "use_slopes"),
        ("bsdf", "bumpmap", "scale"),
        ("bsdf", "principled", "spec_tint"),
        ("bsdf", "principled", "clearcoat_gloss"),
        ("bsdf", "principled", "spec_trans"),
        ("bsdf", "principledthin", "diff_trans"),
        ("bsdf", "hair", "eumelanin"),
        ("bsdf", "hair", "sigma_a"),
        ("bsdf", "hair", "scale"),
        ("bsdf", "hair", "scale_tilt"),
        ("emitter", "envmap", "filename"),
        ("film", "hdrfilm", "pixel_format"),
        ("integrator", "path", "hide_emitters"),
        ("rfilter", "mitchell", "b"),
        ("sensor", "thinlens", "focus_distance"),
        ("shape", "obj", "face_normals"),
        ("texture", "bitmap", "wrap_mode"),
        ("texture", "mesh_attribute", "scale"),
        // As files from before version 2 spell them, and with what they have besides.
        ("bsdf", "dielectric", "intIOR"),
        ("bsdf", "diffuse", "diffuseReflectance"),
        ("integrator", "path", "strictNormals"),
        ("integrator", "path", "maxDepth"),
        ("sensor", "perspective", "toWorld"),
        ("shape", "obj", "collapse"),
        ("texture", "bitmap", "uscale"),
        ("texture", "bitmap", "wrapModeU"),
        ("integrator", "aov", "aovs"),
        ("integrator", "path_sms_glints", "max_trials"),
    ] {
        let (names, _) = &patterns[&(tag.to_owned(), plugin.to_owned())];
        assert!(names.contains(name), "{plugin}: {names:?}");
        assert!(!names.contains("banana"), "{plugin}");
    }
}

/// What stands for an attribute, and for plugins of old, or inside of what others stand in for, is there as well.
#[test]
fn the_schema_knows_all_that_may_stand_somewhere() {
    let text = Scene::schema();
    let schema = Document::parse(&text).unwrap();
    let elements = |plugin: &str, name: &str| -> BTreeSet<String> {
        let define = schema
            .descendants()
            .find(|n| n.has_tag_name("define") && n.attribute("name") == Some(plugin));
        let define = define.unwrap_or_else(|| panic!("{plugin}"));
        let all = define.descendants().filter(|n| n.has_tag_name("element"));
        let named = all.filter(|e| {
            e.descendants()
                .any(|n| n.has_tag_name("value") && n.text() == Some(name))
        });
        named
            .filter_map(|e| e.attribute("name").map(str::to_owned))
            .collect()
    };
    let index = elements("bsdf.dielectric", "int_ior");
    assert!(
        index.contains("string") && index.contains("float"),
        "{index:?}"
    );
    let colour = elements("emitter.constant", "radiance");
    for element in ["blackbody", "float", "rgb", "spectrum", "srgb"] {
        assert!(colour.contains(element), "{element}: {colour:?}");
    }
    for plugin in [
        "sampler.halton",
        "film.ldrfilm",
        "integrator.bdpt",
        "integrator.aov",
        "bsdf.mixturebsdf",
    ] {
        let define = schema
            .descendants()
            .find(|n| n.has_tag_name("define") && n.attribute("name") == Some(plugin));
        let define = define.unwrap_or_else(|| panic!("{plugin}"));
        assert!(
            define
                .descendants()
                .any(|n| n.attribute("name") == Some("anything")),
            "{plugin}"
        );
    }
    // So are plugins of `<default>`s, wherever a plugin may stand.
    let of_default = schema
        .descendants()
        .find(|n| n.has_tag_name("define") && n.attribute("name") == Some("of_default"));
    let tags = of_default.unwrap().descendants();
    let tags: BTreeSet<_> = tags
        .filter(|n| n.has_tag_name("name"))
        .filter_map(|n| n.text())
        .collect();
    assert_eq!(tags, BTreeSet::from(PLUGINS));
    // Names of plugins may be in capitals.
    assert!(text.contains(
        "<value>disk</value><data type=\"string\"><param name=\"pattern\">[Dd][Ii][Ss][Kk]</param></data>"
    ));
    // Others are strict.
    let define = schema
        .descendants()
        .find(|n| n.attribute("name") == Some("integrator.path"));
    assert!(
        !define
            .unwrap()
            .descendants()
            .any(|n| n.attribute("name") == Some("anything"))
    );
}
