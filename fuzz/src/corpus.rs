//! Valid input of every kind, made by code.

use std::io::{Cursor, Write};

use flate2::Compression;
use flate2::write::ZlibEncoder;
use image::{DynamicImage, ImageFormat, Rgb, RgbImage};
use render::image_io::{Pixels, write_exr_pixels};

/// A scene file with some of everything that the format knows, also what no scene would hold together.
pub const DOCUMENT: &str = r##"<?xml version="1.0"?>
<scene version="3.0.0">
    <path value="."/> <path value="absent"/>
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
    <bsdf type="plastic" id="colours">
        <rgb name="a" value="#80ff00"/> <srgb name="b" value="#80ff00"/> <spectrum name="c" value="400:0.5, 700:0.7"/>
        <blackbody name="d" temperature="5000K"/> <spectrum name="e" type="d65"><float name="scale" value="2"/></spectrum>
        <spectrum name="f" type="regular"><string name="values" value="1 2 3"/></spectrum>
    </bsdf>
    <shape type="cylinder"><point name="p0" x="1" y="2" z="3"/><vector name="v" value="1 2 3"/>
        <transform name="to_world">
            <scale value="2"/><rotate y="1" angle="30"/><translate x="1"/>
            <matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/>
        </transform>
        <boolean name="flip_normals" value="true"/> <ref id="paper"/>
        <emitter type="area"><rgb name="radiance" value="$c"/></emitter>
    </shape>
</scene>
"##;

/// A scene that loads, with a mesh `a.obj` and an image `a.png` beside it.
pub const SCENE: &str = r#"<scene version="3.0.0">
    <default name="size" value="8"/>
    <integrator type="path"><integer name="max_depth" value="6"/></integrator>
    <sensor type="perspective">
        <float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
        <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="$size"/><integer name="height" value="$size"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <bsdf type="twosided" id="picture"><bsdf type="diffuse">
        <texture name="reflectance" type="bitmap"><string name="filename" value="a.png"/></texture>
    </bsdf></bsdf>
    <bsdf type="roughplastic" id="plastic"><float name="alpha" value="0.2"/><float name="int_ior" value="1.5"/></bsdf>
    <bsdf type="dielectric" id="glass"><float name="int_ior" value="1.5"/></bsdf>
    <shape type="obj" id="mesh">
        <string name="filename" value="a.obj"/>
        <transform name="to_world"><rotate x="1" angle="30"/><scale value="0.5"/></transform>
        <ref id="picture"/>
    </shape>
    <shape type="sphere"><point name="center" x="1" y="0" z="0"/><float name="radius" value="0.5"/><ref id="glass"/></shape>
    <shape type="cube"><transform name="to_world"><translate value="-1 0 0"/></transform><ref id="plastic"/></shape>
    <shape type="rectangle">
        <transform name="to_world"><translate z="3"/></transform>
        <emitter type="area"><rgb name="radiance" value="1, 2, 3"/></emitter>
    </shape>
    <emitter type="point"><point name="position" value="0 2 0"/><rgb name="intensity" value="1"/></emitter>
</scene>
"#;

/// Another one, with a mesh `a.ply` beside it: what fewer scenes have.
pub const OTHERS: &str = r#"<scene version="2.1.0">
    <integrator type="moment"><integrator type="direct"><boolean name="hideEmitters" value="true"/></integrator></integrator>
    <sensor type="thinlens" id="a"><float name="aperture_radius" value="0.1"/><float name="focus_distance" value="3"/>
        <float name="principal_point_offset_x" value="0.1"/>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>
        <string name="pixelFormat" value="rgba"/></film></sensor>
    <sensor type="orthographic"><transform name="toWorld"><scale x="2" y="2"/></transform></sensor>
    <bsdf type="principled" id="p"><rgb name="base_color" value="0.2"/><float name="roughness" value="0.3"/>
        <float name="metallic" value="0.5"/><float name="specular" value="0.4"/><float name="flatness" value="0.1"/>
        <float name="sheen" value="0.2"/><float name="clearcoat" value="1"/><float name="clearcoat_gloss" value="0.7"/></bsdf>
    <bsdf type="thindielectric" id="t"/>
    <bsdf type="null" id="n"/>
    <bsdf type="twosided" id="b"><bsdf type="roughconductor"><float name="alphaU" value="0.3"/><float name="alphaV" value="0.1"/></bsdf></bsdf>
    <bsdf type="roughdielectric" id="d"><float name="alphaU" value="0.3"/><float name="alphaV" value="0.1"/></bsdf>
    <bsdf type="principled" id="q"><float name="anisotropic" value="0.5"/><float name="spec_trans" value="0.4"/></bsdf>
    <bsdf type="principledthin" id="thin"><float name="diff_trans" value="0.5"/><float name="spec_trans" value="0.4"/>
        <float name="spec_tint" value="0.5"/></bsdf>
    <bsdf type="hair" id="h"><rgb name="sigma_a" value="0.5"/><float name="scale" value="2"/></bsdf>
    <shape type="sphere"><ref id="b"/></shape>
    <shape type="sphere"><ref id="h"/></shape>
    <shape type="sphere"><ref id="d"/></shape>
    <shape type="sphere"><ref id="q"/></shape>
    <shape type="sphere"><ref id="thin"/></shape>
    <shape type="shapegroup" id="g"><shape type="Sphere"><ref id="p"/></shape><shape type="cube"><ref id="t"/></shape></shape>
    <shape type="instance"><ref id="g"/><transform name="toWorld"><translate x="1"/></transform></shape>
    <shape type="ply"><string name="filename" value="a.ply"/><bsdf type="blendbsdf">
        <texture type="mesh_attribute" name="weight"><string name="name" value="vertex_color"/><float name="scale" value="0.5"/></texture>
        <ref id="p"/><ref id="n"/></bsdf></shape>
    <emitter type="directional"><vector name="direction" x="1" y="-1"/><rgb name="irradiance" value="2"/></emitter>
    <emitter type="projector"><float name="fov" value="30"/><float name="scale" value="2"/><texture name="irradiance" type="checkerboard"/></emitter>
    <emitter type="spot"><float name="cutoffAngle" value="30"/><rgb name="intensity" value="3"/>
        <texture name="texture" type="checkerboard"><rgb name="color0" value="0.3"/></texture></emitter>
</scene>
"#;

/// And one of what came last, with files of every kind beside it ([`files`]).
pub const LATEST: &str = r##"<scene version="3.0.0">
    <integrator type="path_sms_ms"><integer name="max_depth" value="4"/><integer name="rr_depth" value="3"/>
        <boolean name="hide_emitters" value="true"/></integrator>
    <sensor type="perspective" id="view"><string name="focal_length" value="35mm"/>
        <float name="near_clip" value="0.01"/><float name="far_clip" value="1000"/>
        <transform name="to_world"><lookat origin="0.5, 1, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="6"/><integer name="height" value="5"/>
        <integer name="crop_width" value="4"/><integer name="crop_height" value="4"/><integer name="crop_offset_x" value="1"/>
        <rfilter type="mitchell"><float name="B" value="0.3"/><float name="C" value="0.4"/></rfilter></film></sensor>
    <sensor type="orthographic" id="flat"><film type="hdrfilm"><integer name="width" value="4"/>
        <integer name="height" value="4"/><rfilter type="lanczos"><integer name="lobes" value="2"/></rfilter></film></sensor>
    <sensor type="thinlens" id="lens"><float name="aperture_radius" value="0.1"/><float name="focus_distance" value="3"/>
        <film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="4"/>
        <rfilter type="gaussian"><float name="stddev" value="0.6"/></rfilter></film></sensor>
    <bsdf type="diffuse" id="red"><spectrum name="reflectance" filename="a.spd"/></bsdf>
    <bsdf type="bumpmap" id="bumps"><texture type="bitmap" name="bumps"><string name="filename" value="a.pfm"/>
        <boolean name="raw" value="true"/><string name="wrap_mode" value="clamp"/></texture><float name="scale" value="0.3"/>
        <boolean name="flip_invalid_normals" value="false"/><bsdf type="plastic"/></bsdf>
    <bsdf type="normalmap" id="bent"><texture type="bitmap" name="normalmap"><string name="filename" value="a.tga"/>
        <boolean name="raw" value="true"/></texture><boolean name="use_shadowing_function" value="true"/>
        <bsdf type="roughplastic"><float name="alpha" value="0.2"/><boolean name="nonlinear" value="true"/></bsdf></bsdf>
    <bsdf type="mask" id="holes"><texture type="checkerboard" name="opacity"><float name="color0" value="0.2"/>
        <float name="color1" value="0.9"/><transform name="to_uv"><scale x="3" y="2"/></transform></texture>
        <bsdf type="twosided"><bsdf type="principled"><rgb name="base_color" value="#80ff00"/>
        <float name="spec_tint" value="0.4"/><float name="sheen" value="0.5"/><float name="sheen_tint" value="0.3"/>
        <float name="metallic" value="0.2"/><float name="roughness" value="0.4"/><float name="anisotropic" value="0.5"/>
        <float name="clearcoat" value="0.6"/><float name="clearcoat_gloss" value="0.8"/><float name="flatness" value="0.3"/>
        </bsdf></bsdf></bsdf>
    <bsdf type="principled" id="glass"><float name="spec_trans" value="0.7"/><float name="eta" value="1.4"/>
        <float name="roughness" value="0.3"/></bsdf>
    <bsdf type="roughconductor" id="metal"><spectrum name="eta" value="400:0.2, 550:0.4, 700:0.1"/>
        <rgb name="k" value="3, 2.5, 2"/><float name="alpha_u" value="0.1"/><float name="alpha_v" value="0.4"/>
        <string name="distribution" value="beckmann"/></bsdf>
    <bsdf type="conductor" id="mirror"><string name="material" value="Ag"/></bsdf>
    <shape type="serialized" id="packed"><string name="filename" value="a.serialized"/><integer name="shape_index" value="0"/>
        <transform name="to_world"><translate z="-1"/></transform><ref id="bumps"/></shape>
    <shape type="ply" id="grown"><string name="filename" value="a.ply"/><boolean name="face_normals" value="false"/>
        <transform name="to_world"><translate x="-1.5"/></transform>
        <texture name="displacement" type="bitmap"><string name="filename" value="a.png"/></texture><ref id="bent"/></shape>
    <shape type="obj" id="shiny"><string name="filename" value="a.obj"/><boolean name="flip_tex_coords" value="true"/>
        <transform name="to_world"><translate y="-1"/></transform>
        <boolean name="caustic_receiver" value="true"/><ref id="red"/></shape>
    <shape type="shapegroup" id="pair"><shape type="obj"><string name="filename" value="a.obj"/><ref id="glass"/></shape>
        <shape type="sphere"><float name="radius" value="0.2"/><ref id="metal"/></shape></shape>
    <shape type="instance"><ref id="pair"/><transform name="to_world"><rotate y="1" angle="20"/><translate x="1"/></transform></shape>
    <shape type="instance"><ref id="pair"/><transform name="to_world"><scale x="0.5" y="-0.5" z="0.5"/><translate y="1"/></transform></shape>
    <shape type="disk"><transform name="to_world"><scale value="0.4"/><translate x="1" z="1"/></transform>
        <boolean name="flip_normals" value="true"/><ref id="holes"/></shape>
    <shape type="cylinder"><point name="p0" x="0" y="0" z="0"/><point name="p1" x="0" y="1" z="0"/>
        <float name="radius" value="0.1"/><boolean name="caustic_caster_single" value="true"/><ref id="mirror"/></shape>
    <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="80"/><translate y="2"/></transform>
        <emitter type="directionalarea"><rgb name="radiance" value="1, 2, 3"/></emitter></shape>
    <shape type="sphere"><point name="center" x="1" y="2" z="0"/><float name="radius" value="0.1"/>
        <emitter type="area"><blackbody name="radiance" temperature="4000"/><float name="sampling_weight" value="2"/></emitter></shape>
    <emitter type="envmap"><string name="filename" value="a.hdr"/><float name="scale" value="0.5"/>
        <transform name="to_world"><rotate y="1" angle="30"/></transform></emitter>
</scene>
"##;

/// Two curves.
pub const CURVES: &str = "-1.0 0.1 0.1 0.5\n-0.3 1.2 1.0 0.5\n0.3 0.3 1.1 0.5\n1.0 1.4 1.2 0.4\n\n\
    -1.0 5.0 2.2 1\n-2.3 4.0 2.3 2\n3.3 3.0 2.2 3\n4.0 2.0 2.3 4\n4.0 1.0 2.2 0\n";

/// A mesh with some of everything.
pub const MESH: &str = "# comment\nmtllib a.mtl\no thing\n\
    v -1 -1 0\nv 1 -1 0 # corner\nv 1 1 0 1 0 0\nv -1 1 0 1\n\
    vt 0 0\nvt 1 0\nvt 1 1 0\nvt 0 1\n\
    vn 0 0 1\nvn 0.1 0 1e0\n\
    g part\nusemtl red\ns 1\n\
    f 1/1/1 2/2/1 3/3/2 4/4/2\nf 1 2 \\\n3\nf -4//-1 -3//-1 -2//-2\nf 1/1 2/2 3/3\nl 1 2\np 1\n";

/// A mesh in text and in binary, little endian, with some of everything.
pub fn polygons() -> [Vec<u8>; 2] {
    let header = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\ncomment x\nelement vertex 4\nproperty float x\nproperty float y\n\
             property float z\nproperty float nx\nproperty float ny\nproperty float nz\nproperty float u\n\
             property float v\nproperty uchar red\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let corners = [[0.0f32, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    let (mut text, mut binary) = (header("ascii"), header("binary_little_endian").into_bytes());
    for [x, y] in corners {
        text += &format!("{x} {y} 0 0 0 1 {x} {y} 7\n");
        let numbers = [x, y, 0.0, 0.0, 0.0, 1.0, x, y];
        binary.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
        binary.push(7);
    }
    for face in [&[0, 1, 2, 3][..], &[0, 2, 1]] {
        let indices: Vec<_> = face.iter().map(i32::to_string).collect();
        text += &format!("{} {}\n", face.len(), indices.join(" "));
        binary.push(face.len() as u8);
        binary.extend(face.iter().flat_map(|i: &i32| i.to_le_bytes()));
    }
    [text.into_bytes(), binary]
}

/// A portable float map, big endian.
fn pfm(pixels: &Pixels) -> Vec<u8> {
    let mut bytes = format!("PF\n{} {}\n1\n", pixels.width, pixels.height).into_bytes();
    let rows = pixels.data.chunks_exact(3 * pixels.width).rev();
    bytes.extend(rows.flatten().flat_map(|x| x.to_be_bytes()));
    bytes
}

/// A portable grey map in text, with a comment.
fn in_text(values: &[u8]) -> Vec<u8> {
    let mut text = "P2 # grey\n24 17\n255\n".to_owned();
    for value in values {
        text += &format!("{value} ");
    }
    text.into_bytes()
}

/// A compressed mesh of one triangle, as Mitsuba writes it.
///
/// # Panics
/// If an encoder fails.
pub fn compressed() -> Vec<u8> {
    let mut body = 0x1000u32.to_le_bytes().to_vec();
    body.extend(b"a\0");
    body.extend([3u64, 1].map(u64::to_le_bytes).as_flattened());
    let corners: [f32; 9] = [-1.0, -1.0, 0.0, 1.0, -1.0, 0.1, 0.0, 1.0, 0.2];
    body.extend(corners.map(f32::to_le_bytes).as_flattened());
    body.extend([0u32, 1, 2].map(u32::to_le_bytes).as_flattened());
    let mut packed = ZlibEncoder::new(vec![0x1c, 0x04, 4, 0], Compression::fast());
    packed.write_all(&body).expect("an encoder");
    let mut bytes = packed.finish().expect("an encoder");
    bytes.extend(0u64.to_le_bytes());
    bytes.extend(1u32.to_le_bytes());
    bytes
}

/// What scenes name, with the names of the files.
///
/// # Panics
/// If an encoder fails.
pub fn files() -> Vec<(String, Vec<u8>)> {
    let mut all: Vec<(String, Vec<u8>)> = (images().into_iter().rev())
        .map(|(ending, bytes)| (format!("a.{ending}"), bytes))
        .collect();
    let [text, _] = polygons();
    all.push(("a.ply".into(), text));
    all.push(("a.obj".into(), MESH.into()));
    all.push(("a.serialized".into(), compressed()));
    all.push((
        "a.spd".into(),
        b"# reflectance\n400 0.1\n550 0.2\n700 0.7\n".to_vec(),
    ));
    all
}

/// An image of every format that is read, with the ending of its name.
///
/// # Panics
/// If an encoder fails.
pub fn images() -> Vec<(&'static str, Vec<u8>)> {
    let pixel = |x: u32, y: u32| Rgb([(20 * x) as u8, (30 * y) as u8, (x * y) as u8]);
    let rgb = DynamicImage::from(RgbImage::from_fn(24, 17, pixel));
    let grey = DynamicImage::from(rgb.to_luma8());
    let deep = DynamicImage::from(rgb.to_rgba16());
    let encode = |image: &DynamicImage, format| {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).expect("an encoder");
        bytes.into_inner()
    };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.exr");
    let pixels = Pixels {
        width: 24,
        height: 17,
        channels: 3,
        data: rgb.to_rgb32f().into_raw(),
    };
    write_exr_pixels(&path, &pixels).expect("an encoder");
    vec![
        ("png", encode(&rgb, ImageFormat::Png)),
        ("png", encode(&grey, ImageFormat::Png)),
        ("png", encode(&deep, ImageFormat::Png)),
        ("jpg", encode(&rgb, ImageFormat::Jpeg)),
        ("jpg", encode(&grey, ImageFormat::Jpeg)),
        ("bmp", encode(&rgb, ImageFormat::Bmp)),
        ("exr", std::fs::read(path).expect("a file")),
        ("tga", encode(&rgb, ImageFormat::Tga)),
        (
            "hdr",
            encode(&DynamicImage::from(rgb.to_rgb32f()), ImageFormat::Hdr),
        ),
        ("pfm", pfm(&pixels)),
        ("ppm", [b"P6\n24 17\n255\n", rgb.as_bytes()].concat()),
        ("pgm", in_text(grey.as_bytes())),
    ]
}
