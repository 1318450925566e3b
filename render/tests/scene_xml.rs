//! The document layer of scene files: what is accepted, and the exact message for what is not.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use approx::assert_relative_eq;
use render::error::SceneError;
use render::plugin::xml::{Document, Node};

use crate::common;

/// A scene with `body` from its second line on.
fn scene(body: &str) -> String {
    format!("<scene version=\"3.0.0\">\n{body}\n</scene>")
}

fn try_load(body: &str) -> Result<Document, SceneError> {
    Document::from_str(&scene(body), Path::new("."), &[])
}

fn load(body: &str) -> Document {
    try_load(body).unwrap_or_else(|error| panic!("{error}"))
}

fn load_with(body: &str, defines: &[(&str, &str)]) -> Result<Document, SceneError> {
    let own = |(name, value): &(&str, &str)| (name.to_string(), value.to_string());
    let defines: Vec<_> = defines.iter().map(own).collect();
    Document::from_str(&scene(body), Path::new("."), &defines)
}

fn message(body: &str) -> String {
    match try_load(body) {
        Ok(_) => panic!("accepted: {body}"),
        Err(error) => error.to_string(),
    }
}

/// A document with one bsdf that has these properties.
fn with_bsdf(properties: &str) -> Document {
    load(&format!("<bsdf type=\"test\">\n{properties}\n</bsdf>"))
}

fn bsdf(document: &Document) -> &Arc<Node> {
    document.root().child_with_tag("bsdf").unwrap().unwrap()
}

fn close(a: [f64; 3], b: [f64; 3]) {
    for i in 0..3 {
        assert_relative_eq!(a[i], b[i], epsilon = 1e-9, max_relative = 1e-9);
    }
}

#[test]
fn every_kind_of_value() {
    let document = with_bsdf(
        r#"
        <float name="alpha" value="0.25"/> <integer name="depth" value="-1"/>
        <boolean name="nonlinear" value="true"/> <string name="distribution" value="ggx"/>
        <rgb name="a" value="0.1, 0.2, 0.3"/> <rgb name="b" value="0.5"/>
        <spectrum name="c" value="0.1 0.2 0.3"/> <spectrum name="d" value="2"/>
        <point name="p0" x="1" y="2" z="3"/> <point name="p1" value="4, 5, 6"/>
        <vector name="v" y="1"/> <transform name="t"/>"#,
    );
    let bsdf = bsdf(&document);
    assert_eq!(bsdf.float("alpha").unwrap(), Some(0.25));
    assert_eq!(bsdf.integer("depth").unwrap(), Some(-1));
    assert_eq!(bsdf.float("depth").unwrap(), Some(-1.0));
    assert_eq!(bsdf.boolean("nonlinear").unwrap(), Some(true));
    assert_eq!(bsdf.string("distribution").unwrap(), Some("ggx"));
    let distributions = [("beckmann", 1), ("ggx", 2)];
    assert_eq!(
        bsdf.choice("distribution", &distributions).unwrap(),
        Some(2)
    );
    assert_eq!(bsdf.rgb("a").unwrap(), Some([0.1, 0.2, 0.3]));
    assert_eq!(bsdf.rgb("b").unwrap(), Some([0.5; 3]));
    assert_eq!(bsdf.rgb("c").unwrap(), Some([0.1, 0.2, 0.3]));
    assert_eq!(bsdf.rgb("d").unwrap(), Some([2.0; 3]));
    assert_eq!(bsdf.rgb("alpha").unwrap(), Some([0.25; 3]));
    assert_eq!(bsdf.point("p0").unwrap(), Some([1.0, 2.0, 3.0]));
    assert_eq!(bsdf.point("p1").unwrap(), Some([4.0, 5.0, 6.0]));
    assert_eq!(bsdf.vector("v").unwrap(), Some([0.0, 1.0, 0.0]));
    assert_eq!(bsdf.transform("t").unwrap(), Some(Default::default()));
    bsdf.finish().unwrap();

    assert_eq!(bsdf.float("absent").unwrap(), None);
    assert_eq!(bsdf.float_or("absent", 3.0).unwrap(), 3.0);
    assert_eq!(bsdf.integer_or("absent", 3).unwrap(), 3);
    assert!(bsdf.boolean_or("absent", true).unwrap());
    assert_eq!(bsdf.string_or("absent", "x").unwrap(), "x");
    assert_eq!(bsdf.rgb_or("absent", [1.0; 3]).unwrap(), [1.0; 3]);
    assert_eq!(bsdf.choice::<u8>("absent", &[]).unwrap(), None);
    assert_eq!(bsdf.path("absent").unwrap(), None);
    assert!(bsdf.has("alpha") && !bsdf.has("absent"));
    assert_eq!(bsdf.float_in("alpha", 0.1, 0.0..=1.0).unwrap(), 0.25);
    assert_eq!(bsdf.integer_in("depth", 1, -1..=10).unwrap(), -1);
}

#[test]
fn wrong_types_and_ranges_name_the_line_and_the_key() {
    let document = with_bsdf(
        r#"<float name="f" value="0.5"/>
<string name="s" value="abc"/>
<integer name="i" value="7"/>
<transform name="t"/>
<texture name="x" type="bitmap"/>
<point name="p" x="1" z="2"/>"#,
    );
    let bsdf = bsdf(&document);
    let cases: [(SceneError, &str); 13] = [
        (
            bsdf.vector("p").unwrap_err(),
            "<text>:8: `p`: expected a vector (<vector>), found <point> `1, 0, 2`",
        ),
        (
            bsdf.integer("f").unwrap_err(),
            "<text>:3: `f`: expected an integer (<integer>), found <float> `0.5`",
        ),
        (
            bsdf.float("s").unwrap_err(),
            "<text>:4: `s`: expected a number (<float>), found <string> `abc`",
        ),
        (
            bsdf.boolean("i").unwrap_err(),
            "<text>:5: `i`: expected true or false (<boolean>), found <integer> `7`",
        ),
        (
            bsdf.string("t").unwrap_err(),
            "<text>:6: `t`: expected a text (<string>), found a <transform>",
        ),
        (
            bsdf.rgb("s").unwrap_err(),
            "<text>:4: `s`: expected a colour (<rgb>), found <string> `abc`",
        ),
        (
            bsdf.rgb("x").unwrap_err(),
            "<text>:7: `x`: expected a colour (<rgb>), found texture `bitmap`",
        ),
        (
            bsdf.point("f").unwrap_err(),
            "<text>:3: `f`: expected a point (<point>), found <float> `0.5`",
        ),
        (
            bsdf.vector("f").unwrap_err(),
            "<text>:3: `f`: expected a vector (<vector>), found <float> `0.5`",
        ),
        (
            bsdf.transform("f").unwrap_err(),
            "<text>:3: `f`: expected a <transform>, found <float> `0.5`",
        ),
        (
            bsdf.choice("s", &[("ggx", 0), ("beckmann", 1)])
                .unwrap_err(),
            "<text>:4: `s`: expected `ggx` or `beckmann`, found <string> `abc`",
        ),
        (
            bsdf.float_in("f", 0.0, 1.0..=2.0).unwrap_err(),
            "<text>:3: `f`: expected a number from 1 to 2, found <float> `0.5`",
        ),
        (
            bsdf.integer_in("i", 0, -1..=6).unwrap_err(),
            "<text>:5: `i`: expected an integer from -1 to 6, found <integer> `7`",
        ),
    ];
    for (error, expected) in cases {
        assert_eq!(error.to_string(), expected);
    }
    assert_eq!(
        bsdf.missing("alpha", "a number").to_string(),
        "<text>:2: bsdf `test` has no `alpha`: expected a number, found nothing"
    );
    assert_eq!(
        bsdf.unknown_plugin(&["diffuse", "mask"]).to_string(),
        "<text>:2: unknown bsdf `test`; known: diffuse, mask"
    );
    let error = bsdf.path("s").unwrap_err().to_string();
    assert!(
        error.starts_with("<text>:4: `s`: expected an existing file (looked in /"),
        "{error}"
    );
    assert!(error.ends_with("), found `abc`"), "{error}");
}

#[test]
fn leftovers_are_errors() {
    let document = with_bsdf(
        r#"<float name="alpha" value="0.5"/>
<float name="foo" value="0.5"/>
<texture name="map" type="bitmap"/>
<bsdf type="diffuse"/>"#,
    );
    let bsdf = bsdf(&document);
    bsdf.float("alpha").unwrap();
    bsdf.string("distribution").unwrap();
    assert_eq!(
        bsdf.finish().unwrap_err().to_string(),
        "<text>:4: unknown attribute `foo` of bsdf `test`; known: alpha, distribution"
    );
    bsdf.ignore(&["foo", "bar"], Node::float).unwrap();
    assert_eq!(
        bsdf.finish().unwrap_err().to_string(),
        "<text>:5: unknown child texture `bitmap` named `map` of bsdf `test`; \
         known: alpha, bar, distribution, foo"
    );
    assert!(bsdf.child("map").is_some() && bsdf.child("other").is_none());
    assert_eq!(
        bsdf.finish().unwrap_err().to_string(),
        "<text>:6: unknown child bsdf `diffuse` of bsdf `test`; \
         known: alpha, bar, distribution, foo, map, other"
    );
    assert_eq!(bsdf.children_with_tag("bsdf").len(), 1);
    bsdf.finish().unwrap();
    assert_eq!(bsdf.children().count(), 2);

    bsdf.ignore(&["foo"], Node::float).unwrap();
    bsdf.warn("is odd");
    let warnings: Vec<_> = document.warnings().iter().map(|w| w.to_string()).collect();
    let expected = [
        "<text>:4: bsdf `test`: `foo` has no effect",
        "<text>:2: bsdf `test`: is odd",
    ];
    assert_eq!(warnings, expected);
}

#[test]
fn declarations_at_the_root_need_not_be_asked_for() {
    let document = load(
        "<bsdf type=\"diffuse\" id=\"used\"/>\n<bsdf type=\"diffuse\" id=\"unused\"/>\n\
         <shape type=\"sphere\"><ref id=\"used\"/></shape>\n<bsdf type=\"diffuse\"/>",
    );
    let root = document.root();
    root.children_with_tag("shape");
    let error = root.finish().unwrap_err().to_string();
    assert_eq!(
        error,
        "<text>:5: unknown child bsdf `diffuse` of the scene; known: <shape>"
    );
    let warnings: Vec<_> = document.warnings().iter().map(|w| w.to_string()).collect();
    assert_eq!(
        warnings,
        ["<text>:3: bsdf `unused` is not referenced by anything"]
    );
    let error = root.child_with_tag("bsdf").unwrap_err().to_string();
    assert_eq!(
        error,
        "<text>:3: <bsdf> of the scene is given twice, first at <text>:2"
    );
}

#[test]
fn transforms_apply_in_the_listed_order() {
    let transform = |body: &str| {
        let document = with_bsdf(&format!("<transform name=\"toWorld\">{body}</transform>"));
        bsdf(&document).transform("to_world").unwrap().unwrap()
    };
    let t = transform(r#"<scale value="2"/><rotate z="1" angle="90"/><translate x="10"/>"#);
    close(t.point([1.0, 0.0, 0.0]), [10.0, 2.0, 0.0]);
    let t = transform(r#"<translate value="1 2 3"/><scale x="2" y="3"/>"#);
    close(t.point([0.0; 3]), [2.0, 6.0, 3.0]);
    let t = transform(r#"<rotate value="0, 1, 0" angle="-90"/><scale value="1, 2, 3"/>"#);
    close(t.point([1.0, 1.0, 0.0]), [0.0, 2.0, 3.0]);
    let t = transform(r#"<matrix value="0 -1 0 5  1 0 0 6  0 0 1 7  0 0 0 1"/>"#);
    close(t.point([1.0, 2.0, 3.0]), [3.0, 7.0, 10.0]);
    let t = transform(r#"<matrix value="0 -1 0  1 0 0  0 0 1"/>"#);
    close(t.point([1.0, 2.0, 3.0]), [-2.0, 1.0, 3.0]);
    let t = transform(r#"<lookat origin="0 0 5" target="0 0 0" up="0 1 0"/>"#);
    close(t.point([0.0, 0.0, 1.0]), [0.0, 0.0, 4.0]);
    close(t.vector([1.0, 0.0, 0.0]), [-1.0, 0.0, 0.0]);
    for target in ["1 0 0", "0 -1 0", "0 0 1", "1 1 1"] {
        let t = transform(&format!(r#"<lookAt origin="0 0 0" target="{target}"/>"#));
        assert_relative_eq!(t.determinant(), 1.0, epsilon = 1e-12);
    }
}

#[test]
fn references_share_one_node() {
    let document = load(
        r#"
        <shape type="sphere"><ref id="later"/></shape>
        <bsdf type="twosided" id="outer"><bsdf type="diffuse" id="inner"/></bsdf>
        <shape type="sphere"><ref name="material" id="inner"/></shape>
        <shape type="sphere"><ref id="twin"/></shape>
        <bsdf type="diffuse" id="later"/>
        <alias id="later" as="twin"/>"#,
    );
    let root = document.root();
    let [first, second, third] = root.children_with_tag("shape")[..] else {
        panic!("three shapes")
    };
    let material = |shape: &Node| shape.child_with_tag("bsdf").unwrap().unwrap().clone();
    let [outer, later] = root.children_with_tag("bsdf")[..] else {
        panic!("two materials")
    };
    assert!(Arc::ptr_eq(&material(first), later));
    assert!(Arc::ptr_eq(&material(third), later));
    assert!(Arc::ptr_eq(&material(second), &material(outer)));
    assert!(Arc::ptr_eq(
        second.child("material").unwrap(),
        &material(outer)
    ));
    assert_eq!(material(second).id.as_deref(), Some("inner"));
}

#[test]
fn both_spellings_of_textures() {
    let document = load(
        r#"<bsdf type="diffuse"><texture name="reflectance" type="bitmap"/></bsdf>
           <bsdf type="diffuse"><spectrum name="reflectance" type="bitmap">
               <string name="filterType" value="bilinear"/>
           </spectrum></bsdf>"#,
    );
    for bsdf in document.root().children_with_tag("bsdf") {
        let texture = bsdf.child("reflectance").unwrap();
        assert_eq!(
            (texture.tag.as_str(), texture.plugin.as_str()),
            ("texture", "bitmap")
        );
        let filter = texture.string("filter_type").unwrap();
        assert!(filter.is_none_or(|f| f == "bilinear"));
        texture.finish().unwrap();
    }
}

#[test]
fn defaults_and_definitions() {
    let body = r#"<default name="x" value="1"/><default name="x" value="2"/>
        <default name="x2" value="$x$x"/><default name="type" value="diffuse"/>
        <bsdf type="$type"><float name="a" value="$x2"/><float name="b" value="-$x.5"/></bsdf>"#;
    let values = |document: &Document| {
        let bsdf = bsdf(document).clone();
        let [a, b] = ["a", "b"].map(|name| bsdf.float(name).unwrap().unwrap());
        (bsdf.plugin.clone(), a, b)
    };
    assert_eq!(values(&load(body)), ("diffuse".to_owned(), 11.0, -1.5));
    let document = load_with(body, &[("x", "9"), ("type", "mask"), ("x", "3")]).unwrap();
    assert_eq!(values(&document), ("mask".to_owned(), 33.0, -3.5));
    // Without a default it must come from outside.
    let open = r#"<bsdf type="$undeclared"/>"#;
    assert!(load_with(open, &[("undeclared", "mask")]).is_ok());
    let error = load_with(body, &[("sppp", "4")]).unwrap_err().to_string();
    assert_eq!(
        error,
        "<text>: no parameter `sppp` to define; known: type, x, x2"
    );
}

/// Numbers and texts.
const OF_VALUES: &[(&str, &str)] = &[
    (
        "<float name=\"a\" value=\"nan\"/>",
        "<text>:2: `a`: expected a finite number, found `nan`",
    ),
    (
        "\n<float name=\"a\"\n value=\"-inf\"/>",
        "<text>:4: `a`: expected a finite number, found `-inf`",
    ),
    (
        "<float name=\"toWorld\" value=\"1e39\"/>",
        "<text>:2: `to_world`: expected a finite number, found `1e39`",
    ),
    (
        "<integer name=\"a\" value=\"1.5\"/>",
        "<text>:2: `a`: expected an integer, found `1.5`",
    ),
    (
        "<boolean name=\"a\" value=\"yes\"/>",
        "<text>:2: `a`: expected `true` or `false`, found `yes`",
    ),
    (
        "<rgb name=\"a\" value=\"1, 2\"/>",
        "<text>:2: `a`: expected one or three numbers, found `1, 2`",
    ),
    (
        "<rgb name=\"a\" value=\"1, 2, x\"/>",
        "<text>:2: `a`: expected a finite number, found `x`",
    ),
    (
        "<point name=\"a\" x=\"1\" y=\"?\"/>",
        "<text>:2: `a.y`: expected a finite number, found `?`",
    ),
    (
        "<point name=\"a\"/>",
        "<text>:2: <point> has no `value`: expected three numbers there, or some of `x`, `y` and `z`, found nothing",
    ),
    (
        "<vector name=\"a\" value=\"1 2 3\" x=\"1\"/>",
        "<text>:2: unknown attribute `x` of <vector>; known: name, value",
    ),
    (
        "<float value=\"1\"/>",
        "<text>:2: <float> has no `name`: expected an attribute, found nothing",
    ),
    (
        "<float name=\"a\"/>",
        "<text>:2: <float> has no `value`: expected an attribute, found nothing",
    ),
    (
        "<float name=\"a\" value=\"1\" unit=\"m\"/>",
        "<text>:2: unknown attribute `unit` of <float>; known: name, value",
    ),
    (
        "<float name=\"a\" value=\"1\">\n<float/></float>",
        "<text>:3: expected nothing inside <float>, found <float>",
    ),
    (
        "<float name=\"a\" value=\"1\"/>\n<integer name=\"a\" value=\"1\"/>",
        "<text>:3: attribute `a` is given twice, first at <text>:2",
    ),
    (
        "<float name=\"a\" value=\"1\"/>\n<texture name=\"a\" type=\"bitmap\"/>",
        "<text>:3: attribute `a` is given twice, first at <text>:2",
    ),
];

/// Structure.
const OF_STRUCTURE: &[(&str, &str)] = &[
    (
        "<bsdf type=\"diffuse\">\n\n  stray\n</bsdf>",
        "<text>:4: expected an element, found the text `stray`",
    ),
    (
        "<bsdf/>",
        "<text>:2: <bsdf> has no `type`: expected an attribute, found nothing",
    ),
    (
        "<bsdf type=\"diffuse\" color=\"1\"/>",
        "<text>:2: unknown attribute `color` of <bsdf>; known: type, id, name",
    ),
    (
        "<bdsf type=\"diffuse\"/>",
        "<text>:2: expected one of the elements alias, blackbody, boolean, bsdf, default, emitter, \
         film, float, include, integer, integrator, path, point, ref, rfilter, rgb, sampler, \
         sensor, shape, spectrum, srgb, string, texture, transform, vector, found <bdsf>",
    ),
    (
        "<bsdf type=\"mask\"></shape>",
        "<text>:2: expected well-formed XML, found an error: expected 'bsdf' tag, not 'shape' \
         at 2:19",
    ),
    (
        "<bsdf type=\"mask\">\n",
        "<text>:4: expected well-formed XML, found an error: expected 'bsdf' tag, not 'scene' \
         at 4:1",
    ),
    (
        "<!DOCTYPE scene []>",
        "<text>:2: expected well-formed XML, found an error: unknown token at 2:1",
    ),
];

/// Transforms.
const OF_TRANSFORMS: &[(&str, &str)] = &[
    (
        "<transform name=\"t\">\n<shear x=\"1\"/></transform>",
        "<text>:3: expected one of lookat, matrix, rotate, scale, translate, found <shear>",
    ),
    (
        "<transform name=\"t\">\n<rotate x=\"1\"/></transform>",
        "<text>:3: <rotate> has no `angle`: expected an attribute, found nothing",
    ),
    (
        "<transform name=\"t\">\n<rotate x=\"0\" angle=\"1\"/></transform>",
        "<text>:3: `t.rotate`: expected an axis, found the zero vector",
    ),
    (
        "<transform name=\"t\"><lookat\norigin=\"0 0 0\" target=\"0 0\"/></transform>",
        "<text>:3: `t.lookat.target`: expected three numbers, found `0 0`",
    ),
    (
        "<transform name=\"t\"><lookat origin=\"1 0 0\" target=\"1 0 0\"/></transform>",
        "<text>:2: `t.lookat`: expected a target away from the origin and not along `up`, \
         found no view direction",
    ),
    (
        "<transform name=\"t\"><matrix value=\"1 2 3\"/></transform>",
        "<text>:2: `t.matrix`: expected 9 numbers, or 16 with last row 0 0 0 1, found `1 2 3`",
    ),
    (
        "<transform name=\"t\"><scale z=\"0\"/></transform>",
        "<text>:2: `t`: expected an invertible transform with finite entries, \
         found one that is singular or overflows",
    ),
    (
        "<transform name=\"t\"><scale value=\"1e30\"/><scale value=\"1e30\"/></transform>",
        "<text>:2: `t`: expected an invertible transform with finite entries, \
         found one that is singular or overflows",
    ),
    (
        "<transform name=\"t\"><scale value=\"2\" by=\"3\"/></transform>",
        "<text>:2: unknown attribute `by` of <scale>; known: value",
    ),
];

/// Substitution.
const OF_SUBSTITUTION: &[(&str, &str)] = &[
    (
        "<default name=\"size\" value=\"1\"/>\n<float name=\"a\" value=\"$sizes\"/>",
        "<text>:3: `$sizes` is not defined; known: $size",
    ),
    (
        "<float name=\"a\" value=\"$a\"/><default name=\"a\" value=\"1\"/>",
        "<text>:2: `$a` is not defined; known: (none)",
    ),
    (
        "<string name=\"a\" value=\"5$\"/>",
        "<text>:2: `$` is not defined; known: (none)",
    ),
    (
        "<default name=\"\" value=\"1\"/>",
        "<text>:2: `default.name`: expected a name, found ``",
    ),
    (
        "<default name=\"a\"/>",
        "<text>:2: <default> has no `value`: expected an attribute, found nothing",
    ),
];

/// References.
const OF_REFERENCES: &[(&str, &str)] = &[
    (
        "<bsdf type=\"diffuse\" id=\"red\"/>\n<shape type=\"sphere\"><ref id=\"rde\"/></shape>",
        "<text>:3: no element has the id `rde`; known: red",
    ),
    (
        "<bsdf type=\"diffuse\" id=\"red\"/>\n<bsdf type=\"mask\" id=\"red\"/>",
        "<text>:3: id `red` is given twice, first at <text>:2",
    ),
    (
        "<bsdf type=\"twosided\" id=\"a\">\n<ref id=\"b\"/></bsdf>\n\
         <bsdf type=\"twosided\" id=\"b\">\n<ref id=\"a\"/></bsdf>",
        "<text>:5: bsdf at <text>:2 contains itself",
    ),
    (
        "<bsdf type=\"twosided\" id=\"a\"><ref id=\"a\"/></bsdf>",
        "<text>:2: bsdf at <text>:2 contains itself",
    ),
    (
        "<ref name=\"a\"/>",
        "<text>:2: <ref> has no `id`: expected an attribute, found nothing",
    ),
    (
        "<alias id=\"a\" as=\"b\"/>",
        "<text>:2: no element has the id `a`; known: (none)",
    ),
    (
        "<bsdf type=\"mask\" id=\"a\"/>\n<alias id=\"a\" as=\"a\"/>",
        "<text>:3: id `a` is given twice, first at <text>:2",
    ),
];

/// Messages in full: file, line, what was expected, what was found.
#[test]
fn messages() {
    let cases = [
        OF_VALUES,
        OF_STRUCTURE,
        OF_TRANSFORMS,
        OF_SUBSTITUTION,
        OF_REFERENCES,
    ];
    for (body, expected) in cases.concat() {
        assert_eq!(message(body), expected, "\nof {body}");
    }
}

#[test]
fn the_root_must_be_a_scene_of_a_known_version() {
    let cases = [
        (
            "<bsdf type=\"diffuse\"/>",
            "<text>:1: expected <scene>, found <bsdf>",
        ),
        (
            "<scene/>",
            "<text>:1: <scene> has no `version`: expected an attribute, found nothing",
        ),
        (
            "<!-- old -->\n<scene version=\"0.3.0\"/>",
            "<text>:2: `version`: expected 0.4 to 0.6, 2.x.x or 3.x.x, found `0.3.0`",
        ),
        (
            "<scene version=\"3.0.0\" type=\"x\"/>",
            "<text>:1: unknown attribute `type` of <scene>; known: version, id",
        ),
        (
            "",
            "<text>:1: expected well-formed XML, found an error: the document does not have a \
             root node",
        ),
        (
            "<scene version=\"3.0.0\">\n<bsdf ",
            "<text>:2: expected well-formed XML, found an error: unexpected end of stream",
        ),
        (
            "<!DOCTYPE x [<!ENTITY a \"b\">]><scene version=\"3.0.0\"/>",
            "<text>:1: expected no entities, found <!ENTITY",
        ),
        (
            "<scene version=\"3.0.0\"><scene version=\"3.0.0\"/></scene>",
            "<text>:1: expected one of the elements alias, blackbody, boolean, bsdf, default, emitter, \
             film, float, include, integer, integrator, path, point, ref, rfilter, rgb, sampler, \
             sensor, shape, spectrum, srgb, string, texture, transform, vector, found <scene>",
        ),
    ];
    for (text, expected) in cases {
        let error = Document::from_str(text, Path::new("."), &[]).unwrap_err();
        assert_eq!(error.to_string(), expected, "\nof {text}");
    }
    let text = "\u{feff}<?xml version=\"1.0\"?>\n<!-- c --><scene version=\"2.1.0\" id=\"s\"/>\n<!-- d -->";
    let document = Document::from_str(text, Path::new("."), &[]).unwrap();
    assert_eq!(document.root().location.line, 2);
    assert_eq!(document.root().id.as_deref(), Some("s"));
    document.root().finish().unwrap();
}

/// Files in a fresh folder.
fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    for (name, text) in files {
        let path = dir.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    dir
}

fn include(file: &str) -> String {
    scene(&format!("<include filename=\"{file}\"/>"))
}

#[test]
fn includes_take_their_place_and_keep_their_lines() {
    let main = scene(
        "<default name=\"grey\" value=\"0.25\"/>\n<include filename=\"parts/shapes.xml\"/>\n\
         <bsdf type=\"diffuse\" id=\"white\"><float name=\"reflectance\" value=\"$late\"/></bsdf>",
    );
    let dir = folder(&[
        ("main.xml", &main),
        (
            "parts/shapes.xml",
            "\u{feff}<scene version=\"2.0.0\">\n<include filename=\"deep/one.xml\"/>\n\
             <default name=\"late\" value=\"0.75\"/>\n</scene>",
        ),
        (
            "parts/deep/one.xml",
            "<!-- one -->\n<shape type=\"obj\" version=\"2.0.0\"><ref id=\"white\"/>\n\
             <string name=\"filename\" value=\"mesh.obj\"/>\n\
             <string name=\"other\" value=\"inner.obj\"/>\n\
             <float name=\"grey\" value=\"$grey\"/></shape>",
        ),
        ("mesh.obj", ""),
        ("inner.obj", ""),
        ("parts/deep/inner.obj", ""),
    ]);
    let document = Document::load(&dir.path().join("main.xml"), &[]).unwrap();
    let shape = document.root().children_with_tag("shape")[0];
    assert!(shape.location.file.ends_with("parts/deep/one.xml"));
    assert_eq!(shape.location.line, 2);
    assert_eq!(shape.float("grey").unwrap(), Some(0.25));
    let white = shape.child_with_tag("bsdf").unwrap().unwrap();
    assert_eq!(white.float("reflectance").unwrap(), Some(0.75));
    // Beside the file that names it first, then beside the files that include that one.
    let path = |name| shape.path(name).unwrap().unwrap();
    assert_eq!(path("filename"), dir.path().join("mesh.obj"));
    assert_eq!(path("other"), dir.path().join("parts/deep/inner.obj"));
    let error = shape.boolean("grey").unwrap_err().to_string();
    assert!(
        error.contains("one.xml:5: `grey`: expected true or false"),
        "{error}"
    );
}

#[test]
fn errors_of_files_name_the_file() {
    let missing = "shapes.xml";
    let dir = folder(&[
        ("cycle.xml", &include("parts/back.xml")),
        ("parts/back.xml", &include("../cycle.xml")),
        ("self.xml", &include("self.xml")),
        ("missing.xml", &include(missing)),
        ("folder.xml", &include("parts")),
        ("bad.xml", &include("parts/bad.xml")),
        (
            "parts/bad.xml",
            "<scene version=\"3.0.0\">\n<float/></scene>",
        ),
        (
            "duplicate.xml",
            &scene("<bsdf type=\"a\" id=\"x\"/>\n<include filename=\"parts/x.xml\"/>"),
        ),
        ("parts/x.xml", "<bsdf type=\"b\" id=\"x\"/>"),
        ("old.xml", &include("parts/old.xml")),
        ("parts/old.xml", "<scene version=\"1.0\"/>"),
        ("reference.xml", &include("parts/reference.xml")),
        (
            "parts/reference.xml",
            "\n<shape type=\"sphere\"><ref id=\"x\"/></shape>",
        ),
    ]);
    fs::write(
        dir.path().join("latin.xml"),
        b"<scene version=\"3.0.0\">\n<!-- \xe9 --></scene>",
    )
    .unwrap();
    let cases = [
        (
            "cycle.xml",
            "/back.xml:2: the file `../cycle.xml` contains itself",
        ),
        (
            "self.xml",
            "self.xml:2: the file `self.xml` contains itself",
        ),
        (
            "missing.xml",
            "missing.xml:2: `include`: expected an existing file (looked in ",
        ),
        ("missing.xml", "), found `shapes.xml`"),
        (
            "folder.xml",
            "folder.xml:2: `include`: expected an existing file (looked in ",
        ),
        (
            "bad.xml",
            "/bad.xml:2: <float> has no `name`: expected an attribute, found nothing",
        ),
        ("duplicate.xml", "x.xml:1: id `x` is given twice, first at "),
        ("duplicate.xml", "duplicate.xml:2"),
        (
            "old.xml",
            "/old.xml:1: `version`: expected 0.4 to 0.6, 2.x.x or 3.x.x, found `1.0`",
        ),
        (
            "reference.xml",
            "/reference.xml:2: no element has the id `x`; known: (none)",
        ),
        (
            "latin.xml",
            "latin.xml:2: expected text in UTF-8, found the byte 0xe9",
        ),
        ("absent.xml", "absent.xml: cannot read the file: "),
        ("parts", "parts: expected a regular file, found a directory"),
    ];
    for (file, expected) in cases {
        let error = Document::load(&dir.path().join(file), &[])
            .unwrap_err()
            .to_string();
        assert!(
            error.contains(expected),
            "{file}: {error}\nlacks {expected}"
        );
    }
}

#[test]
fn no_input_exhausts_stack_or_memory() {
    const MANY: usize = 100_000;
    // Deep nesting, closed and unclosed.
    let open = "<bsdf type=\"a\">".repeat(MANY);
    let deep = format!("{open}{}", "</bsdf>".repeat(MANY));
    let limit = "<text>:2: expected at most 64 levels of nesting, found more";
    assert_eq!(message(&deep), limit);
    assert!(try_load(&open).is_err());
    // Chains of references, in both directions.
    let mut links: Vec<_> = (0..MANY)
        .map(|i| {
            format!(
                "<bsdf type=\"a\" id=\"b{i}\"><ref id=\"b{}\"/></bsdf>\n",
                i + 1
            )
        })
        .collect();
    let end = format!("<bsdf type=\"a\" id=\"b{MANY}\"/>\n");
    assert!(message(&(links.concat() + &end)).ends_with("levels of nesting, found more"));
    links.reverse();
    assert!(message(&(end + &links.concat())).ends_with("levels of nesting, found more"));
    // Sharing that a walk of the tree expands to 2^40 nodes.
    let doubling: String = (0..40)
        .map(|i| {
            let reference = format!("<ref id=\"b{}\"/>", i + 1);
            format!("<bsdf type=\"a\" id=\"b{i}\">{reference}{reference}</bsdf>")
        })
        .collect();
    let doubling = doubling + "<bsdf type=\"a\" id=\"b40\"/>";
    assert!(message(&doubling).ends_with("expected at most 1048576 elements, found more"));
    // Defaults that double each other.
    let defaults: String = (0..60)
        .map(|i| format!("<default name=\"x{}\" value=\"$x{i}$x{i}\"/>", i + 1))
        .collect();
    let defaults = format!("<default name=\"x0\" value=\"0123456789\"/>{defaults}");
    let error = message(&defaults);
    assert!(error.ends_with("expected at most 67108864 bytes of substituted text, found more"));
    // Files that include the next one many times, and a long chain of files.
    let dir = tempfile::tempdir().unwrap();
    for i in 0..20 {
        let next = format!("<include filename=\"f{}.xml\"/>", i + 1);
        fs::write(
            dir.path().join(format!("f{i}.xml")),
            scene(&next.repeat(10)),
        )
        .unwrap();
    }
    fs::write(dir.path().join("f20.xml"), scene("")).unwrap();
    fs::write(dir.path().join("f5.xml"), scene("")).unwrap();
    assert!(Document::load(&dir.path().join("f0.xml"), &[]).is_ok());
    for i in 0..100 {
        let next = format!("<include filename=\"c{}.xml\"/>", i + 1);
        fs::write(dir.path().join(format!("c{i}.xml")), scene(&next)).unwrap();
    }
    let error = Document::load(&dir.path().join("c0.xml"), &[]).unwrap_err();
    assert!(
        error.to_string().ends_with("levels of nesting, found more"),
        "{error}"
    );
}

/// The number of nodes, shared ones once per use.
fn count(node: &Node) -> usize {
    1 + node
        .children()
        .map(|(_, child)| count(child))
        .sum::<usize>()
}

#[test]
fn all_shared_scenes_load() {
    let Some(shared) = common::shared_dir() else {
        return;
    };
    let mut loaded = 0;
    for folder in ["scenes", "peer/scenes"] {
        for path in common::files_below(&shared.join(folder), "xml") {
            let mut result = Document::load(&path, &[]);
            // Some leave a number to the command line.
            if let Err(SceneError::UndefinedParameter { name, .. }) = &result {
                let name = name.trim_start_matches('$').to_owned();
                result = Document::load(&path, &[(name, "0.1".to_owned())]);
            }
            match result {
                Ok(document) => {
                    assert!(count(document.root()) > 1, "{}", path.display());
                    loaded += 1;
                }
                // A fragment refers to what its including file defines.
                Err(SceneError::UnknownReference { .. })
                    if path.ends_with("fragments/shapes.xml") => {}
                Err(error) => panic!("{error}"),
            }
        }
    }
    assert!(loaded > 0, "no scene files in {}", shared.display());
}

#[test]
fn the_cornell_box_of_fragments_resolves() {
    let Some(shared) = common::shared_dir() else {
        return;
    };
    let file = shared.join("scenes/cbox/cbox-rgb.xml");
    let document = Document::load(&file, &[("res".to_owned(), "64".to_owned())]).unwrap();
    let root = document.root();
    let shapes = root.children_with_tag("shape");
    assert_eq!(shapes.len(), 8);
    assert!(
        shapes
            .iter()
            .all(|s| s.path("filename").unwrap().unwrap().is_file())
    );
    let light = shapes[0].child_with_tag("emitter").unwrap().unwrap();
    assert_eq!(
        light.rgb("radiance").unwrap(),
        Some([18.387, 10.9873, 2.75357])
    );
    let sensor = root.child_with_tag("sensor").unwrap().unwrap();
    let camera = sensor.transform("to_world").unwrap().unwrap();
    close(camera.point([0.0, 0.0, 1.0]), [278.0, 273.0, -799.0]);
    let film = sensor.child_with_tag("film").unwrap().unwrap();
    assert_eq!(film.integer("width").unwrap(), Some(64));
}

/// Each of these took minutes when something was compared with all that came before it.
#[test]
fn long_files_load_in_time() {
    let n = 100_000;
    let many = |line: &dyn Fn(usize) -> String| (0..n).map(line).collect::<String>();
    let defaults = many(&|i| format!("<default name=\"n{i}\" value=\"$n{}\"/>\n", i - i.min(1)));
    let document = load_with(&defaults, &[("n0", "1")]);
    assert!(document.is_ok());
    let comments = "<!-- x -->".repeat(n);
    let bodies = many(&|i| format!("<bsdf type=\"diffuse\" id=\"b{i}\"/>\n"));
    let text = format!("{comments}<scene version=\"3.0.0\">{bodies}</scene>");
    Document::from_str(&text, Path::new("."), &[]).unwrap();
    let attributes = many(&|i| format!(" a{i}=\"x\""));
    assert!(
        message(&format!("<bsdf type=\"diffuse\" {attributes}/>"))
            .ends_with("expected at most 64 attributes of an element, found more")
    );
    let namespaces = many(&|i| format!("<bsdf xmlns:n{i}=\"x{i}\">"));
    assert!(message(&namespaces).ends_with("expected at most 64 namespaces, found more"));
}

#[test]
fn the_longest_known_name_is_substituted() {
    let defines = [
        ("a", "1"),
        ("ab", "2"),
        ("a-b", "3"),
        ("é", "4"),
        ("é-", "5"),
        ("a-b-c", "6"),
    ];
    for (text, expected) in [
        ("$a", "1"),
        ("$ab", "2"),
        ("$a-b", "3"),
        ("$a-bc", "1-bc"),
        ("$a-b-", "3-"),
        ("$a-b-cd", "3-cd"),
        ("$é", "4"),
        ("$é-x", "4-x"),
        ("$é- $a", "5 1"),
    ] {
        let declared: String = (defines.iter())
            .map(|(name, value)| format!("<default name=\"{name}\" value=\"{value}\"/>"))
            .collect();
        let body =
            format!("{declared}<bsdf type=\"test\"><string name=\"s\" value=\"{text}\"/></bsdf>");
        let document = load(&body);
        assert_eq!(
            bsdf(&document).string("s").unwrap(),
            Some(expected),
            "{text}"
        );
    }
}

#[test]
fn includes_that_double_are_limited() {
    let twice = |i: usize| {
        format!(
            "<scene version=\"3.0.0\">{0}{0}</scene>",
            format!("<include filename=\"f{i}.xml\"/>")
        )
    };
    let texts: Vec<(String, String)> = (0..24)
        .map(|i| {
            (
                format!("f{i}.xml"),
                if i < 23 { twice(i + 1) } else { scene("") },
            )
        })
        .collect();
    let files: Vec<(&str, &str)> = texts
        .iter()
        .map(|(n, t)| (n.as_str(), t.as_str()))
        .collect();
    let dir = folder(&files);
    let error = Document::load(&dir.path().join("f0.xml"), &[])
        .unwrap_err()
        .to_string();
    assert!(
        error.ends_with("expected at most 131072 included files, found more"),
        "{error}"
    );
}

#[cfg(unix)]
#[test]
fn devices_and_pipes_are_refused_by_name() {
    let dir = folder(&[("a.xml", &include("pipe.xml"))]);
    let pipe = dir.path().join("pipe.xml");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.is_ok_and(|status| status.success()));
    let error = |path: &Path| Document::load(path, &[]).unwrap_err().to_string();
    let found = error(Path::new("/dev/zero"));
    assert_eq!(found, "/dev/zero: expected a regular file, found a device");
    for path in [pipe, dir.path().join("a.xml")] {
        let found = error(&path);
        assert!(
            found.ends_with("pipe.xml: expected a regular file, found a pipe"),
            "{found}"
        );
    }
    let found = error(dir.path());
    assert!(
        found.ends_with("expected a regular file, found a directory"),
        "{found}"
    );
}

#[test]
fn messages_quote_little_of_what_is_long() {
    let long = "x".repeat(1 << 20);
    for body in [
        format!("<float name=\"a\" value=\"{long}\"/>"),
        format!("<{long}/>"),
        format!("<bsdf type=\"diffuse\" {long}=\"1\"/>"),
        format!("<shape type=\"sphere\"><ref id=\"{long}\"/></shape>"),
        format!("<float name=\"a\" value=\"${long}\"/>"),
        format!("<include filename=\"{long}\"/>"),
        format!("<bsdf type=\"a\" id=\"{long}\"/><bsdf type=\"a\" id=\"{long}\"/>"),
        format!("&{long};"),
        format!("<a></{long}>"),
        long.clone(),
    ] {
        let found = try_load(&body).map(|_| ()).unwrap_err().to_string();
        assert!(
            found.len() < 1000,
            "{} bytes: {}",
            found.len(),
            &found[..500]
        );
    }
}

#[test]
fn colours_in_hexadecimal_and_on_the_srgb_curve() {
    let document = with_bsdf(
        r##"<rgb name="a" value="#ff3300"/><srgb name="b" value="#ff3300"/><srgb name="c" value="0.5"/>"##,
    );
    let bsdf = bsdf(&document);
    close(bsdf.rgb("a").unwrap().unwrap(), [1.0, 0.2, 0.0]);
    close(
        bsdf.rgb("b").unwrap().unwrap(),
        [1.0, 0.033_104_766_570_885_05, 0.0],
    );
    close(
        bsdf.rgb("c").unwrap().unwrap(),
        [0.214_041_140_482_232_55; 3],
    );
    let found = message("<bsdf type=\"x\"><rgb name=\"a\" value=\"#ff33\"/></bsdf>");
    let expected = "<text>:2: `a`: expected `#` and six hexadecimal digits, found `#ff33`";
    assert_eq!(found, expected);
}

#[test]
fn spectra_are_seen_in_rgb() {
    let document = with_bsdf(
        r#"<spectrum name="reflectance" value="300:0.25, 900:0.25"/>
        <spectrum name="specular_reflectance" value="505:0, 510:1, 515:0"/>
        <spectrum name="eta" value="300:3 900:3"/>
        <texture type="uniform" name="u"><float name="value" value="0.5"/></texture>
        <spectrum type="srgb" name="s"><rgb name="color" value="0.1 0.2 0.3"/></spectrum>
        <texture type="rawconstant" name="r"><rgb name="value" value="0.3 0.2 0.1"/></texture>
        <spectrum type="d65" name="d"><float name="scale" value="2"/></spectrum>
        <spectrum type="irregular" name="i"><string name="wavelengths" value="300, 900"/><string name="values" value="2 2"/></spectrum>
        <blackbody name="b" temperature="5000K" scale="1e-4"/>"#,
    );
    let bsdf = bsdf(&document);
    let rgb = |name: &str| bsdf.rgb(name).unwrap().unwrap();
    close(rgb("reflectance"), [0.25; 3]);
    close(rgb("eta"), [3.0; 3]);
    close(rgb("u"), [0.5; 3]);
    close(rgb("s"), [0.1, 0.2, 0.3]);
    close(rgb("r"), [0.3, 0.2, 0.1]);
    close(rgb("d"), [2.0; 3]);
    close(rgb("i"), [2.0; 3]);
    let warm = rgb("b");
    assert!(
        warm[0] > warm[1] && warm[1] > warm[2] && warm[2] > 0.0,
        "{warm:?}"
    );
    let green = rgb("specular_reflectance");
    assert!(green[0] == 0.0 && green[1] > 0.0, "{green:?}");
    bsdf.finish().unwrap();
    let warnings = document.warnings();
    assert_eq!(warnings.len(), 1);
    let warning = warnings[0].to_string();
    assert!(
        warning.starts_with(
            "<text>:4: `specular_reflectance`: a spectrum whose colour RGB cannot show"
        ),
        "{warning}"
    );
}

#[test]
fn spectra_that_are_none_are_errors() {
    for (element, line, expected) in [
        (
            "<spectrum name=\"a\" value=\"500:1, 400:1\"/>",
            3,
            "`a`: expected at least two wavelengths with values",
        ),
        (
            "<spectrum name=\"a\" filename=\"none.spd\"/>",
            3,
            "`a`: expected an existing file",
        ),
        (
            "<blackbody name=\"a\" temperature=\"-5\"/>",
            3,
            "`a.temperature`: expected a temperature in kelvin",
        ),
        ("<blackbody name=\"a\"/>", 3, "`temperature`"),
    ] {
        let found = message(&format!("<bsdf type=\"x\">\n{element}</bsdf>"));
        assert!(
            found.starts_with(&format!("<text>:{line}: ")) && found.contains(expected),
            "{found}"
        );
    }
    for (spectrum, expected) in [
        ("type=\"srgb\"/>", "`color`"),
        ("type=\"blackbody\"/>", "`temperature`"),
        (
            "type=\"blackbody\"><float name=\"temperature\" value=\"3000\"/><float name=\"scale\" value=\"2\"/></spectrum>",
            "unknown attribute `scale`",
        ),
        (
            "type=\"uniform\"><float name=\"x\" value=\"1\"/></spectrum>",
            "`x`",
        ),
        (
            "type=\"regular\"><string name=\"values\" value=\"1\"/></spectrum>",
            "expected at least two numbers",
        ),
        (
            "type=\"irregular\"><string name=\"values\" value=\"1 2\"/><string name=\"wavelengths\" value=\"500\"/></spectrum>",
            "expected at least two numbers",
        ),
    ] {
        let document = with_bsdf(&format!("<spectrum name=\"a\" {spectrum}"));
        let found = bsdf(&document).rgb("a").unwrap_err().to_string();
        assert!(
            found.starts_with("<text>:3: ") && found.contains(expected),
            "{found}"
        );
    }
}

#[test]
fn spectra_are_read_from_files() {
    let dir = folder(&[
        ("a.spd", "# nm, value\n300 0.5\n900 0.5\n"),
        ("b.spd", "300 0.5\nhalf\n"),
        (
            "a.xml",
            &scene("<bsdf type=\"x\"><spectrum name=\"a\" filename=\"a.spd\"/></bsdf>"),
        ),
        (
            "b.xml",
            &scene("<bsdf type=\"x\"><spectrum name=\"a\" filename=\"b.spd\"/></bsdf>"),
        ),
    ]);
    let document = Document::load(&dir.path().join("a.xml"), &[]).unwrap();
    close(bsdf(&document).rgb("a").unwrap().unwrap(), [0.5; 3]);
    let found = Document::load(&dir.path().join("b.xml"), &[])
        .unwrap_err()
        .to_string();
    let expected = "b.spd: expected at least two lines with a wavelength and a value, wavelengths increasing, found `half`";
    assert!(found.ends_with(expected), "{found}");
}

/// As Mitsuba 3 upgrades them.
#[test]
fn versions_before_2_are_upgraded() {
    let old = |version: &str, body: &str| {
        let text = format!("<scene version=\"{version}\">{body}</scene>");
        Document::from_str(&text, Path::new("."), &[]).unwrap()
    };
    let body = r#"<bsdf type="diffuse"><texture type="bitmap" name="diffuseReflectance">
        <float name="uoffset" value="0.5"/><float name="vscale" value="3"/><float name="uscale" value="2"/>
        <string name="filterType" value="nearest"/></texture></bsdf>"#;
    for version in ["0.4.0", "0.5.0", "0.6.0", "0.6"] {
        let document = old(version, body);
        let bsdf = bsdf(&document);
        let texture = bsdf.child("reflectance").unwrap();
        assert_eq!(texture.string("filter_type").unwrap(), Some("nearest"));
        let to_uv = texture.transform("to_uv").unwrap().unwrap();
        close(to_uv.point([0.25, 0.5, 0.0]), [1.5, 1.5, 0.0]);
        texture.finish().unwrap();
        bsdf.finish().unwrap();
    }
    let document = old("2.0.0", body);
    assert!(bsdf(&document).child("reflectance").is_none());
    let plain = old(
        "0.6.0",
        "<bsdf type=\"diffuse\"><rgb name=\"diffuseReflectance\" value=\"0.3\"/></bsdf>",
    );
    close(bsdf(&plain).rgb("reflectance").unwrap().unwrap(), [0.3; 3]);
    // What has its new name already keeps it, and the old one is left over.
    let both = old(
        "0.6.0",
        "<bsdf type=\"diffuse\"><rgb name=\"reflectance\" value=\"0.1\"/><rgb name=\"diffuseReflectance\" value=\"0.3\"/></bsdf>",
    );
    close(bsdf(&both).rgb("reflectance").unwrap().unwrap(), [0.1; 3]);
    assert!(bsdf(&both).finish().is_err());
    // A flat lamp is white.
    let lamp = old(
        "0.6.0",
        "<emitter type=\"constant\"><spectrum name=\"radiance\" value=\"2\"/></emitter>",
    );
    let emitter = lamp.root().child_with_tag("emitter").unwrap().unwrap();
    close(emitter.rgb("radiance").unwrap().unwrap(), [2.0; 3]);
}

/// Of lamps, a number at all wavelengths is grey as the plugin `uniform`, and of equal energy as the value of a spectrum,
/// as Mitsuba 3.9 shows them.
#[test]
fn lamps_of_one_number() {
    let lamp = |inner: &str| {
        let document = load(&format!("<emitter type=\"constant\">{inner}</emitter>"));
        let emitter = document.root().child_with_tag("emitter").unwrap().unwrap();
        emitter.rgb("radiance").unwrap().unwrap()
    };
    for tag in ["spectrum", "texture"] {
        let uniform = format!(
            "<{tag} type=\"uniform\" name=\"radiance\"><float name=\"value\" value=\"2\"/></{tag}>"
        );
        close(lamp(&uniform), [2.0; 3]);
    }
    close(lamp("<float name=\"radiance\" value=\"2\"/>"), [2.0; 3]);
    let energy = lamp("<spectrum name=\"radiance\" value=\"2\"/>");
    // IEC 61966-2-1.
    for (found, expected) in energy.iter().zip([1.2048, 0.9483, 0.9089]) {
        assert!((found - 2.0 * expected).abs() < 1e-3, "{energy:?}");
    }
}

/// Names with backslashes, or with other capitals than the file has, and a warning; the file of the very name comes first,
/// and one of several that are meant alike is not guessed.
#[test]
#[cfg(target_os = "linux")]
fn names_of_files_may_be_those_of_other_systems() {
    let plugin = |name: &str| {
        scene(&format!(
            "<bsdf type=\"x\"><string name=\"f\" value=\"{name}\"/></bsdf>"
        ))
    };
    let dir = folder(&[
        ("parts/Wood.PNG", ""),
        ("parts/grey.png", ""),
        ("parts/Grey.png", ""),
        ("both.png", ""),
        ("a.xml", &plugin("Parts\\wood.png")),
        ("b.xml", &plugin("parts/wood.png")),
        ("c.xml", &plugin("parts/Wood.PNG")),
        ("d.xml", &plugin("parts\\grey.png")),
        ("e.xml", &plugin("parts/GREY.png")),
        ("f.xml", &plugin("parts\\..\\Both.png")),
        ("g.xml", &plugin("parts\\none.png")),
        ("inner/h.xml", &plugin("a.png")),
        ("i.xml", &include("Inner\\H.xml")),
        (
            "j.xml",
            &scene(
                "<path value=\"PARTS\"/>\n<bsdf type=\"x\"><string name=\"f\" value=\"Wood.PNG\"/></bsdf>",
            ),
        ),
    ]);
    let load = |name: &str| Document::load(&dir.path().join(name), &[]).unwrap();
    for (file, found, warnings) in [
        ("a.xml", "parts/Wood.PNG", 1),
        ("b.xml", "parts/Wood.PNG", 1),
        ("c.xml", "parts/Wood.PNG", 0),
        ("d.xml", "parts/grey.png", 1),
        ("f.xml", "both.png", 1),
        ("j.xml", "parts/Wood.PNG", 1),
    ] {
        let document = load(file);
        let path = bsdf(&document).path("f").unwrap().unwrap();
        let [path, expected] = [path, dir.path().join(found)].map(|p| p.canonicalize().unwrap());
        assert_eq!(path, expected, "{file}");
        assert_eq!(document.warnings().len(), warnings, "{file}");
    }
    let document = load("a.xml");
    bsdf(&document).path("f").unwrap();
    let warning = document.warnings()[0].to_string();
    assert!(
        warning.contains("a.xml:2: bsdf `x`: `f`: there is no `Parts\\wood.png`; "),
        "{warning}"
    );
    assert!(warning.ends_with("Wood.PNG is read instead"), "{warning}");
    for file in ["e.xml", "g.xml"] {
        let error = bsdf(&load(file)).path("f").unwrap_err().to_string();
        assert!(error.contains("an existing file"), "{error}");
    }
    assert_eq!(load("i.xml").warnings().len(), 1);
}

#[test]
fn paths_are_looked_in_from_where_they_stand() {
    let dir = folder(&[
        (
            "a.xml",
            "<scene version=\"3.0.0\">\n<path value=\"common\"/>\n<path value=\"absent\"/>\n<include filename=\"b.xml\"/>\n</scene>",
        ),
        (
            "common/b.xml",
            "<scene version=\"3.0.0\"><bsdf type=\"x\"><string name=\"f\" value=\"c.png\"/></bsdf></scene>",
        ),
        ("common/c.png", ""),
        (
            "nested.xml",
            &scene("<bsdf type=\"x\">\n<path value=\"common\"/></bsdf>"),
        ),
        (
            "late.xml",
            &scene("<include filename=\"b.xml\"/>\n<path value=\"common\"/>"),
        ),
        ("many.xml", &scene(&"<path value=\"common\"/>\n".repeat(65))),
    ]);
    let load = |name: &str| Document::load(&dir.path().join(name), &[]);
    let document = load("a.xml").unwrap();
    let found = bsdf(&document).path("f").unwrap().unwrap();
    assert!(found.ends_with("common/c.png"), "{}", found.display());
    let warnings: Vec<_> = document
        .warnings()
        .iter()
        .map(ToString::to_string)
        .collect();
    assert_eq!(warnings.len(), 1);
    assert!(
        warnings[0].contains("a.xml:3: <path>: there is no folder `absent` (looked in "),
        "{warnings:?}"
    );
    let error = |name: &str| load(name).unwrap_err().to_string();
    assert!(
        error("nested.xml")
            .contains("nested.xml:3: expected <path> in <scene> itself, found <path>"),
        "{}",
        error("nested.xml")
    );
    assert!(error("late.xml").contains("late.xml:2: `include`: expected an existing file"));
    assert!(
        error("many.xml").contains("many.xml:66: "),
        "{}",
        error("many.xml")
    );
}

#[test]
fn other_encodings_are_read_where_they_say_so() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.xml");
    let text = |encoding: &str| {
        format!(
            "<?xml version=\"1.0\" encoding='{encoding}'?>\n<!DOCTYPE scene SYSTEM \"scene.dtd\">\n<scene version=\"3.0.0\">
            <bsdf type=\"x\"><string name=\"s\" value=\"é\"/></bsdf></scene>"
        )
    };
    let load = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        let document = Document::load(&path, &[]).map_err(|e| e.to_string())?;
        Ok(bsdf(&document).string("s").unwrap().unwrap().to_owned())
    };
    let latin = |text: &str| -> Vec<u8> { text.chars().map(|c| c as u8).collect() };
    let wide = |text: &str, mark: bool, to: fn(u16) -> [u8; 2]| -> Vec<u8> {
        let mark = if mark { "\u{feff}" } else { "" };
        format!("{mark}{text}")
            .encode_utf16()
            .flat_map(to)
            .collect()
    };
    assert_eq!(load(text("UTF-8").as_bytes()).unwrap(), "é");
    assert_eq!(
        load(format!("\u{feff}{}", text("UTF-8")).as_bytes()).unwrap(),
        "é"
    );
    assert_eq!(load(&latin(&text("ISO-8859-1"))).unwrap(), "é");
    assert_eq!(load(&latin(&text("latin1"))).unwrap(), "é");
    for to in [u16::to_le_bytes, u16::to_be_bytes] {
        let bytes = wide(&text("UTF-16"), true, to);
        assert_eq!(load(&bytes).unwrap(), "é");
        let error: Result<String, String> = load(&bytes[..bytes.len() - 1]);
        assert!(
            error
                .unwrap_err()
                .contains("a.xml:1: expected text in UTF-16")
        );
    }
    let error = load(&latin(&text("KOI8-R"))).unwrap_err();
    assert!(
        error.contains(
            "a.xml:4: expected text in UTF-8 or Latin-1, not `koi8-r`, found the byte 0xe9"
        ),
        "{error}"
    );
    let error = load(&latin(&text("UTF-8"))).unwrap_err();
    assert!(
        error.contains("a.xml:4: expected text in UTF-8, found the byte 0xe9"),
        "{error}"
    );
    let bomb =
        "<?xml version=\"1.0\"?>\n<!DOCTYPE scene [\n<!ENTITY a \"b\">]><scene version=\"3.0.0\"/>";
    let error = load(bomb.as_bytes()).unwrap_err();
    assert!(
        error.contains("a.xml:3: expected no entities, found <!ENTITY"),
        "{error}"
    );
}
