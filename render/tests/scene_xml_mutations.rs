//! Scene text that is damaged in every way must give a document or an error, never a panic.

mod common;

use std::fs;
use std::path::Path;

use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use render::scene::xml::{Document, Node};

/// Some of everything, for machines without the shared scenes.
const SAMPLE: &str = r#"<?xml version="1.0"?>
<scene version="3.0.0">
    <default name="spp" value="16"/> <default name="c" value="0.1, 0.2, 0.3"/>
    <integrator type="path"><integer name="max_depth" value="6"/></integrator>
    <sensor type="perspective">
        <transform name="toWorld"><lookat origin="0, 3, 14" target="0, 1, 0" up="0, 1, 0"/></transform>
        <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
        <ref id="film"/>
    </sensor>
    <film type="hdrfilm" id="film"><rfilter type="box"/></film> <!-- comment -->
    <bsdf type="twosided" id="white"><bsdf type="diffuse">
        <spectrum name="reflectance" type="bitmap"><string name="filename" value="a.png"/></spectrum>
    </bsdf></bsdf>
    <alias id="white" as="paper"/>
    <shape type="cylinder"><point name="p0" x="1" y="2" z="3"/><vector name="v" value="1 2 3"/>
        <transform name="to_world">
            <scale value="2"/><rotate y="1" angle="30"/><translate x="1"/>
            <matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/>
        </transform>
        <boolean name="flip_normals" value="true"/> <ref id="paper"/>
        <emitter type="area"><rgb name="radiance" value="$c"/></emitter>
    </shape>
</scene>
"#;

/// Pieces that mean something to the parser.
const PIECES: [&str; 20] = [
    "<",
    "/>",
    "\"",
    "&amp;",
    "&#0;",
    "]]>",
    "<![CDATA[x]]>",
    "<!--",
    "<?x?>",
    "$",
    "$spp",
    "nan",
    "1e999",
    "\u{feff}",
    "é",
    "<ref id=\"white\"/>",
    "<include filename=\".\"/>",
    "<default name=\"c\" value=\"$c$c\"/>",
    "<bsdf type=\"x\" id=\"white\"/>",
    "<scale value=\"0\"/>",
];

/// Positions are fractions of the current length, in 1/65536.
#[derive(Debug, Clone)]
enum Mutation {
    Replace { at: u16, byte: u8 },
    Flip { at: u16, bit: u8 },
    Truncate { at: u16 },
    Remove { from: u16, length: u8 },
    Duplicate { from: u16, length: u16, to: u16 },
    Insert { at: u16, piece: usize },
}

fn mutation() -> impl Strategy<Value = Mutation> {
    use Mutation::*;
    prop_oneof![
        (any::<u16>(), any::<u8>()).prop_map(|(at, byte)| Replace { at, byte }),
        (any::<u16>(), 0..8_u8).prop_map(|(at, bit)| Flip { at, bit }),
        any::<u16>().prop_map(|at| Truncate { at }),
        (any::<u16>(), any::<u8>()).prop_map(|(from, length)| Remove { from, length }),
        (any::<u16>(), 0..2000_u16, any::<u16>()).prop_map(|(from, length, to)| Duplicate {
            from,
            length,
            to
        }),
        (any::<u16>(), 0..PIECES.len()).prop_map(|(at, piece)| Insert { at, piece }),
    ]
}

fn apply(text: &mut Vec<u8>, mutation: &Mutation) {
    let length = text.len();
    let position = |at: u16| length * usize::from(at) / 65536;
    match *mutation {
        Mutation::Replace { at, byte } => {
            if let Some(b) = text.get_mut(position(at)) {
                *b = byte;
            }
        }
        Mutation::Flip { at, bit } => {
            if let Some(b) = text.get_mut(position(at)) {
                *b ^= 1 << bit;
            }
        }
        Mutation::Truncate { at } => text.truncate(position(at)),
        Mutation::Remove { from, length: n } => {
            let from = position(from);
            text.drain(from..(from + usize::from(n)).min(length));
        }
        Mutation::Duplicate {
            from,
            length: n,
            to,
        } => {
            let from = position(from);
            let chunk = text[from..(from + usize::from(n)).min(length)].to_vec();
            let to = position(to);
            text.splice(to..to, chunk);
        }
        Mutation::Insert { at, piece } => {
            let at = position(at);
            text.splice(at..at, PIECES[piece].bytes());
        }
    }
}

fn texts() -> Vec<Vec<u8>> {
    let mut texts = vec![SAMPLE.as_bytes().to_vec()];
    if let Some(shared) = common::shared_dir() {
        for folder in ["scenes", "peer/scenes"] {
            let files = common::files_below(&shared.join(folder), "xml");
            texts.extend(files.iter().filter_map(|path| fs::read(path).ok()));
        }
    }
    texts
}

/// Asks for everything in every way.
fn exercise(node: &Node) {
    for name in [
        "value",
        "filename",
        "reflectance",
        "radiance",
        "to_world",
        "alpha",
        "p0",
        "width",
    ] {
        let errors = [
            node.float(name).err(),
            node.integer(name).err(),
            node.boolean(name).err(),
            node.string(name).err(),
            node.path(name).err(),
            node.rgb(name).err(),
            node.point(name).err(),
            node.vector(name).err(),
            node.transform(name).err(),
        ];
        for error in errors.into_iter().flatten() {
            assert!(!error.to_string().is_empty());
        }
        if let Ok(Some(x)) = node.float(name) {
            assert!((x as f32).is_finite());
        }
        if let Ok(Some(t)) = node.transform(name) {
            assert!(t.to_f32().as_flattened().iter().all(|x| x.is_finite()));
            assert!(t.inverse().is_some());
        }
    }
    if let Err(error) = node.finish() {
        assert!(error.to_string().contains(": unknown "));
    }
    for (_, child) in node.children() {
        exercise(child);
    }
    node.finish().ok();
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 3000,
        rng_seed: RngSeed::Fixed(1),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn damaged_text_never_panics(
        which in any::<prop::sample::Index>(),
        mutations in prop::collection::vec(mutation(), 1..6),
    ) {
        thread_local!(static TEXTS: Vec<Vec<u8>> = texts());
        let mut text = TEXTS.with(|texts| which.get(texts).clone());
        for mutation in &mutations {
            apply(&mut text, mutation);
        }
        let text = String::from_utf8_lossy(&text);
        match Document::from_str(&text, Path::new("."), &[]) {
            Ok(document) => exercise(document.root()),
            Err(error) => prop_assert!(!error.to_string().is_empty()),
        }
    }
}

/// The sample is valid, so that the mutations start from something that is read to the end.
#[test]
fn undamaged_sample_loads() {
    let document = Document::from_str(SAMPLE, Path::new("."), &[]).unwrap();
    exercise(document.root());
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("cut.xml");
    for end in 0..SAMPLE.len() {
        fs::write(&path, &SAMPLE.as_bytes()[..end]).unwrap();
        let whole = SAMPLE[..end].trim_end().ends_with("</scene>");
        assert_eq!(
            Document::load(&path, &[]).is_ok(),
            whole,
            "cut at byte {end}"
        );
    }
}
