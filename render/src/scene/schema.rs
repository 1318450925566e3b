//! A schema of scene files, by which editors complete and check them.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::Path;

use super::load::{Reading, plugins};
use super::{LoadOptions, Scene};
use crate::error::SceneError;
use crate::plugin::Node;
use crate::plugin::xml::{ANYTHING, Document, Kind, old_attributes};

/// What a plugin asks for: names, and what may stand there.
type Asked = BTreeMap<String, BTreeSet<Kind>>;

/// So many attributes that a plugin cannot do without are found out one after another.
const MOST_NEEDED: usize = 8;

/// Plugins of before version 2 that become others.
const OLD: &[(&str, &str)] = &[("bsdf", "mixturebsdf")];

/// Elements that any plugin may have besides its own, and what all of them consist of.
const COMMON: &str = r#"<define name="value"><attribute name="value"/></define>
<define name="name"><optional><attribute name="name"/></optional></define>
<define name="id"><optional><attribute name="id"/></optional></define>
<define name="coordinates"><choice><ref name="value"/><group><attribute name="x"/><attribute name="y"/>
<attribute name="z"/></group></choice></define>
<define name="spectrum"><choice><ref name="colour"/><attribute name="filename"/><group><attribute name="type"/>
<ref name="inside"/></group></choice></define>
<define name="colour"><ref name="value"/><optional><attribute name="intent"/></optional></define>
<define name="blackbody"><attribute name="temperature"/><optional><attribute name="scale"/></optional></define>
<define name="operations"><zeroOrMore><element><choice><name>lookat</name><name>lookAt</name><name>matrix</name><name>rotate</name>
<name>scale</name><name>translate</name></choice><zeroOrMore><attribute><anyName/></attribute></zeroOrMore></element>
</zeroOrMore></define>
<define name="reference"><element name="ref"><attribute name="id"/><ref name="name"/></element></define>
<define name="inside"><zeroOrMore><ref name="anything"/></zeroOrMore></define>
<define name="anything"><element><anyName/><zeroOrMore><attribute><anyName/></attribute></zeroOrMore><ref name="inside"/>
</element></define>
<define name="directives"><choice><ref name="reference"/>
<element name="include"><attribute name="filename"/></element>
<element name="path"><ref name="value"/></element>
<element name="alias"><attribute name="id"/><attribute name="as"/></element>
<element name="default"><attribute name="name"/><ref name="value"/></element>
<ref name="of_default"/></choice></define>
"#;

impl Scene {
    /// A schema of scene files, RELAX NG in its XML syntax: every plugin with its attributes and what may stand there. It is
    /// made by asking: each plugin is built, and what it asks for is written down. Names from before version 2, which are
    /// upgraded, are in it in their own case and with the attributes that they are given; where another plugin stands in,
    /// anything may stand inside, and so it may where the plugin is that of a `<default>`. Plugins are known in capitals, too,
    /// which editors do not propose.
    ///
    /// # Does not handle
    /// Which attributes a plugin cannot do without, or not have together, and what values mean: [`Scene::check`] does.
    pub fn schema() -> String {
        let mut out = String::from(
            "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<grammar xmlns=\"http://relaxng.org/ns/structure/1.0\"\n\
             datatypeLibrary=\"http://www.w3.org/2001/XMLSchema-datatypes\">\n<start>\
             <element name=\"scene\"><attribute name=\"version\"/><zeroOrMore><choice>\n<ref name=\"directives\"/>\n",
        );
        let all = plugins();
        for (tag, _) in &all {
            let _ = writeln!(out, "<ref name=\"{tag}\"/>");
        }
        out.push_str("</choice></zeroOrMore></element></start>\n");
        out.push_str(COMMON);
        let tags: String = (all.iter().map(|(tag, _)| format!("<name>{tag}</name>"))).collect();
        let _ = writeln!(
            out,
            "<define name=\"of_default\"><element><choice>{tags}</choice><attribute name=\"type\">{}</attribute>\
             <ref name=\"id\"/><ref name=\"name\"/><ref name=\"inside\"/></element></define>",
            pattern(".*[$].*")
        );
        for (tag, plugins) in &all {
            let _ = writeln!(out, "<define name=\"{tag}\"><choice>");
            let old = OLD
                .iter()
                .filter(|(of, _)| of == tag)
                .map(|(_, plugin)| plugin);
            for plugin in plugins.iter().chain(old.clone()) {
                let _ = writeln!(out, "<ref name=\"{tag}.{plugin}\"/>");
            }
            out.push_str("</choice></define>\n");
            for plugin in plugins {
                define(&mut out, tag, plugin, &asked_by(tag, plugin));
            }
            for plugin in old {
                let anything = (ANYTHING.to_owned(), BTreeSet::from([Kind::Either]));
                define(&mut out, tag, plugin, &Asked::from([anything]));
            }
        }
        out.push_str("</grammar>\n");
        out
    }
}

/// The pattern of one plugin.
fn define(out: &mut String, tag: &str, plugin: &str, asked: &Asked) {
    let _ = writeln!(
        out,
        "<define name=\"{tag}.{plugin}\"><element name=\"{tag}\"><attribute name=\"type\"><choice><value>{plugin}</value>{}\
         </choice></attribute><ref name=\"id\"/><ref name=\"name\"/><zeroOrMore><choice>\n<ref name=\"directives\"/>",
        pattern(&in_any_case(plugin))
    );
    let textured = |kinds: &BTreeSet<Kind>| kinds.contains(&Kind::Child) || kinds.len() == 1;
    let nested = |(name, kinds): (&String, &BTreeSet<Kind>)| {
        let kind = kinds.contains(&Kind::Child) || kinds.contains(&Kind::Either);
        !name.starts_with('<') && kind && textured(kinds)
    };
    if asked.iter().any(nested) && !asked.contains_key("<texture>") {
        out.push_str("<ref name=\"texture\"/>\n");
    }
    let old = old_attributes(tag, plugin, asked);
    let all = (asked.iter().map(|(name, kinds)| (name.as_str(), kinds)))
        .chain(old.iter().map(|(name, kinds)| (*name, kinds)));
    for (name, kinds) in all {
        if name == ANYTHING {
            out.push_str("<ref name=\"anything\"/>\n");
            continue;
        }
        if let Some(tag) = name.strip_prefix('<') {
            let _ = writeln!(out, "<ref name=\"{}\"/>", tag.trim_end_matches('>'));
            continue;
        }
        let values: String = (spellings(name).iter())
            .map(|name| format!("<value>{name}</value>"))
            .collect();
        for (element, content) in elements(kinds) {
            let _ = writeln!(
                out,
                "<element name=\"{element}\"><attribute name=\"name\"><choice>{values}</choice></attribute>{content}</element>"
            );
        }
    }
    out.push_str("</choice></zeroOrMore></element></define>\n");
}

/// A text that matches a regular expression.
fn pattern(expression: &str) -> String {
    format!("<data type=\"string\"><param name=\"pattern\">{expression}</param></data>")
}

/// The regular expression of a name in small or capital letters.
fn in_any_case(name: &str) -> String {
    let either = |c: char| {
        if c.is_ascii_lowercase() {
            format!("[{}{c}]", c.to_ascii_uppercase())
        } else {
            c.to_string()
        }
    };
    name.chars().map(either).collect()
}

/// A name, and how files of before version 2 spell it: `int_ior`, `intIor`, `intIOR`.
fn spellings(name: &str) -> Vec<String> {
    let mut all = vec![name.to_owned()];
    let words: Vec<&str> = name.split('_').collect();
    let plain = |word: &&str| word.starts_with(|c: char| c.is_ascii_lowercase());
    if words.len() < 2 || !words.iter().all(plain) {
        return all;
    }
    let capital = |word: &str| format!("{}{}", word[..1].to_ascii_uppercase(), &word[1..]);
    let first = words[..words.len() - 1].iter().enumerate();
    let first: String = first
        .map(|(i, word)| match i {
            0 => (*word).to_owned(),
            _ => capital(word),
        })
        .collect();
    let last = words[words.len() - 1];
    all.push(format!("{first}{}", capital(last)));
    if (2..=3).contains(&last.len()) {
        all.push(format!("{first}{}", last.to_ascii_uppercase()));
    }
    all
}

/// The elements that may stand for what is asked for, and what they consist of besides their name.
fn elements(kinds: &BTreeSet<Kind>) -> Vec<(&'static str, &'static str)> {
    const VALUE: &str = "<ref name=\"value\"/>";
    const COORDINATES: &str = "<ref name=\"coordinates\"/>";
    const NUMBERS: [(&str, &str); 2] = [("float", VALUE), ("integer", VALUE)];
    const COLOUR: &str = "<ref name=\"colour\"/>";
    const COLOURS: [(&str, &str); 4] = [
        ("blackbody", "<ref name=\"blackbody\"/>"),
        ("rgb", COLOUR),
        ("spectrum", "<ref name=\"spectrum\"/>"),
        ("srgb", COLOUR),
    ];
    let mut all = BTreeSet::new();
    for kind in kinds {
        match kind {
            Kind::Number => all.extend(NUMBERS),
            Kind::Integer => all.extend([("integer", VALUE)]),
            Kind::Boolean => all.extend([("boolean", VALUE)]),
            Kind::Text => all.extend([("string", VALUE)]),
            Kind::Colour => all.extend(NUMBERS.into_iter().chain(COLOURS)),
            Kind::Point => all.extend([("point", COORDINATES)]),
            Kind::Vector => all.extend([("vector", COORDINATES)]),
            Kind::Transform => all.extend([("transform", "<ref name=\"operations\"/>")]),
            Kind::Either if kinds.len() == 1 => all.extend(NUMBERS.into_iter().chain(COLOURS)),
            Kind::Child | Kind::Either => {}
        }
    }
    all.into_iter().collect()
}

/// All that a plugin asks for, in any place where it may stand, with none, one or two materials inside.
fn asked_by(tag: &str, plugin: &str) -> Asked {
    let mut all = Asked::new();
    for nested in 0..=2 {
        let mut content = r#"<bsdf type="diffuse"/>"#.repeat(nested);
        for _ in 0..MOST_NEEDED {
            let element = format!(r#"<{tag} type="{plugin}" name="reflectance">{content}</{tag}>"#);
            let mut needed = None;
            for around in places(tag) {
                let text = around.replace("{}", &element);
                // On a line of its own: what the scene lacks is not the plugin's.
                let text = format!("<scene version=\"3.0.0\">\n{text}</scene>");
                needed = needed.or(ask(&text, (tag, plugin), &mut all));
            }
            // Of the type that is expected.
            let Some((key, expected)) = needed else { break };
            let (element, value) = if expected.contains("name") {
                ("string", "0.5")
            } else if expected.contains("vector") {
                ("vector", "0, 0, 1")
            } else {
                ("float", "0.5")
            };
            let _ = write!(content, r#"<{element} name="{key}" value="{value}"/>"#);
        }
    }
    all.remove("type");
    all
}

/// Where a plugin of a kind may stand.
fn places(tag: &str) -> &'static [&'static str] {
    match tag {
        "bsdf" => &[r#"<shape type="sphere">{}</shape>"#],
        "texture" => &[r#"<shape type="sphere"><bsdf type="diffuse">{}</bsdf></shape>"#],
        "emitter" => &["{}", r#"<shape type="sphere">{}</shape>"#],
        "film" | "sampler" => &[r#"<sensor type="perspective">{}</sensor>"#],
        "rfilter" => &[r#"<sensor type="perspective"><film type="hdrfilm">{}</film></sensor>"#],
        _ => &["{}"],
    }
}

/// Reads a scene and adds what its plugin of this kind and name asks for. What it cannot do without, and what is expected
/// there, if that is missing.
fn ask(text: &str, which: (&str, &str), all: &mut Asked) -> Option<(String, String)> {
    let document = Document::from_str(text, Path::new("."), &[]).ok()?;
    let options = LoadOptions {
        allow_missing: true,
        ..LoadOptions::default()
    };
    let mut reading = Reading::new(&options, Some(Vec::new()));
    // What is wrong with it is in the list.
    let _ = reading.scene(document.root(), &options);
    let node = found(document.root(), which)?;
    for (name, kinds) in node.asked() {
        all.entry(name).or_default().extend(kinds);
    }
    reading.faults.into_iter().flatten().find_map(|e| match e {
        SceneError::Missing {
            location,
            key,
            expected,
            ..
        } if location == node.location && !all.contains_key(&format!("<{key}>")) => {
            Some((key, expected))
        }
        _ => None,
    })
}

/// The first plugin of a kind and a name below a node.
fn found<'a>(node: &'a Node, (tag, plugin): (&str, &str)) -> Option<&'a Node> {
    node.parts().find_map(|part| {
        if part.tag == tag && part.plugin == plugin {
            Some(&**part)
        } else {
            found(part, (tag, plugin))
        }
    })
}
