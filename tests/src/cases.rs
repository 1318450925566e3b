//! One small scene per material and emitter: every parameter of it is tested.

/// A named scene body for [`crate::scene`].
#[derive(Clone, Debug)]
pub struct Case {
    /// What is tested.
    pub name: &'static str,
    /// Elements inside `<scene>`.
    pub body: String,
}

const CAMERA: &str = r#"
    <sensor type="perspective">
        <float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0, 1.2, 4" target="0, 0.3, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="8"/><integer name="height" value="8"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <integrator type="path"><integer name="max_depth" value="4"/><integer name="rr_depth" value="3"/></integrator>"#;

const FLOOR: &str = r#"
    <shape type="rectangle" id="floor">
        <transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform>
        <bsdf type="diffuse" id="floor_bsdf"><rgb name="reflectance" value="0.6, 0.5, 0.4"/></bsdf>
    </shape>"#;

const AREA: &str = r#"
    <shape type="rectangle" id="light">
        <transform name="to_world"><scale value="0.8"/><rotate x="1" angle="90"/><translate x="0.5" y="3" z="1"/></transform>
        <bsdf type="diffuse" id="black"><rgb name="reflectance" value="0.1"/></bsdf>
        <emitter type="area"><rgb name="radiance" value="5, 4, 3"/></emitter>
    </shape>"#;

const SKY: &str =
    r#"<emitter type="constant" id="sky"><rgb name="radiance" value="0.4, 0.5, 0.6"/></emitter>"#;

fn ball(bsdf: &str) -> String {
    format!(
        r#"<shape type="sphere" id="ball"><point name="center" value="0, 0.6, 0"/><float name="radius" value="0.6"/>{bsdf}</shape>"#
    )
}

/// A ball of the material on a diffuse floor, under an area light and a constant sky.
fn material(name: &'static str, bsdf: &str) -> Case {
    Case {
        name,
        body: format!("{CAMERA}{FLOOR}{AREA}{SKY}{}", ball(bsdf)),
    }
}

/// A diffuse ball on a diffuse floor under the emitter.
fn emitter(name: &'static str, emitter: &str) -> Case {
    let ball =
        ball(r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.3, 0.2"/></bsdf>"#);
    Case {
        name,
        body: format!("{CAMERA}{FLOOR}{ball}{emitter}"),
    }
}

/// A plate of the material that no light or eye sees at a grazing angle, under an area light and a constant sky. On a ball
/// normals turn from the viewer along an edge that no derivative sees (`tests/normal_maps.rs`).
fn plate(name: &'static str, bsdf: &str) -> Case {
    Case {
        name,
        body: format!(
            r#"{CAMERA}{AREA}{SKY}<shape type="rectangle" id="plate">
            <transform name="to_world"><rotate x="1" angle="-45"/><translate y="0.3"/></transform>{bsdf}</shape>"#
        ),
    }
}

/// The material below normals up to fifteen degrees off.
fn tilted(nested: &str) -> String {
    format!(
        r#"<bsdf type="normalmap"><texture name="normalmap" type="checkerboard">
        <rgb name="color0" value="0.6, 0.45, 0.95"/><rgb name="color1" value="0.42, 0.55, 0.9"/></texture>{nested}</bsdf>"#
    )
}

/// Every material and every emitter, except environment maps: those need files, which `attached_emitters.rs`,
/// `auto.rs`, `estimator_matrix.rs` and `render/tests/emitters.rs` write.
pub fn all() -> Vec<Case> {
    let mut all = materials();
    all.extend(emitters());
    all.extend(brushed());
    all.push(hidden_lamps());
    all
}

fn materials() -> Vec<Case> {
    vec![
        material(
            "diffuse",
            r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.3, 0.2"/></bsdf>"#,
        ),
        material(
            "conductor",
            r#"<bsdf type="conductor"><rgb name="specular_reflectance" value="0.8, 0.7, 0.6"/><string name="material" value="Au"/></bsdf>"#,
        ),
        material(
            "dielectric",
            r#"<bsdf type="dielectric"><float name="int_ior" value="1.5"/></bsdf>"#,
        ),
        material(
            "ggx",
            r#"<bsdf type="roughconductor"><string name="distribution" value="ggx"/><float name="alpha" value="0.25"/><string name="material" value="Cu"/></bsdf>"#,
        ),
        material(
            "beckmann",
            r#"<bsdf type="roughconductor"><string name="distribution" value="beckmann"/><float name="alpha" value="0.3"/><rgb name="specular_reflectance" value="0.8, 0.7, 0.6"/></bsdf>"#,
        ),
        material(
            "ggx, all normals",
            r#"<bsdf type="roughconductor"><string name="distribution" value="ggx"/><float name="alpha" value="0.3"/><boolean name="sample_visible" value="false"/></bsdf>"#,
        ),
        material(
            "rough dielectric",
            r#"<bsdf type="roughdielectric"><string name="distribution" value="ggx"/><float name="alpha" value="0.3"/><float name="int_ior" value="1.5"/></bsdf>"#,
        ),
        material(
            "plastic",
            r#"<bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.5, 0.3, 0.2"/></bsdf>"#,
        ),
        material(
            "rough plastic",
            r#"<bsdf type="roughplastic"><float name="alpha" value="0.2"/><rgb name="diffuse_reflectance" value="0.5, 0.3, 0.2"/></bsdf>"#,
        ),
        material(
            "blinn-phong",
            r#"<bsdf type="blinnphong"><rgb name="diffuse_reflectance" value="0.3, 0.3, 0.2"/><rgb name="specular_reflectance" value="0.3, 0.4, 0.5"/><float name="exponent" value="12"/></bsdf>"#,
        ),
        material(
            "two-sided blend",
            r#"<bsdf type="twosided"><bsdf type="blendbsdf"><float name="weight" value="0.3"/><bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.3, 0.2"/></bsdf><bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf></bsdf></bsdf>"#,
        ),
        material(
            "mask",
            r#"<bsdf type="mask"><float name="opacity" value="0.6"/><bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.3, 0.2"/></bsdf></bsdf>"#,
        ),
        material(
            "window",
            r#"<bsdf type="thindielectric"><float name="int_ior" value="1.5"/><rgb name="specular_transmittance" value="0.8, 0.9, 0.7"/></bsdf>"#,
        ),
        material(
            "principled",
            r#"<bsdf type="principled"><rgb name="base_color" value="0.7, 0.3, 0.2"/><float name="roughness" value="0.6"/><float name="metallic" value="0.3"/><float name="specular" value="0.6"/><float name="flatness" value="0.3"/><float name="sheen" value="0.4"/><float name="clearcoat" value="0.5"/><float name="clearcoat_gloss" value="0.1"/></bsdf>"#,
        ),
        material(
            "principled with tints",
            r#"<bsdf type="principled"><rgb name="base_color" value="0.7, 0.3, 0.2"/><float name="roughness" value="0.6"/><float name="metallic" value="0.3"/><float name="specular" value="0.6"/><float name="sheen" value="0.8"/><float name="spec_tint" value="0.7"/><float name="sheen_tint" value="0.6"/></bsdf>"#,
        ),
        material(
            "principled glass",
            r#"<bsdf type="principled"><rgb name="base_color" value="0.7, 0.5, 0.4"/><float name="roughness" value="0.6"/><float name="metallic" value="0.2"/><float name="eta" value="1.5"/><float name="spec_trans" value="0.6"/></bsdf>"#,
        ),
        material(
            "principled thin",
            r#"<bsdf type="principledthin"><rgb name="base_color" value="0.7, 0.5, 0.4"/><float name="roughness" value="0.6"/><float name="spec_trans" value="0.4"/><float name="eta" value="1.5"/><float name="spec_tint" value="0.3"/><float name="diff_trans" value="0.8"/><float name="flatness" value="0.3"/><float name="sheen" value="0.6"/><float name="sheen_tint" value="0.5"/></bsdf>"#,
        ),
        material(
            "hair",
            r#"<bsdf type="hair"><float name="eumelanin" value="0.4"/></bsdf>"#,
        ),
        material(
            "white hair",
            r#"<bsdf type="hair"><rgb name="sigma_a" value="0.1, 0.2, 0.4"/><float name="scale" value="0.7"/><float name="longitudinal_roughness" value="0.4"/><float name="azimuthal_roughness" value="0.5"/><float name="scale_tilt" value="4"/></bsdf>"#,
        ),
        material("nothing", r#"<bsdf type="null"/>"#),
        material(
            "checkerboard",
            r#"<bsdf type="diffuse"><texture name="reflectance" type="checkerboard"><rgb name="color0" value="0.7, 0.3, 0.2"/><rgb name="color1" value="0.2, 0.4, 0.6"/></texture></bsdf>"#,
        ),
        plate(
            "normal map",
            &tilted(
                r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.3, 0.2"/></bsdf>"#,
            ),
        ),
        plate(
            "normal map of metal",
            &tilted(r#"<bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf>"#),
        ),
    ]
}

fn emitters() -> Vec<Case> {
    vec![
        emitter("area", AREA),
        emitter(
            "directional lobe",
            &AREA.replace(
                "<emitter type=\"area\">",
                "<emitter type=\"area\"><float name=\"exponent\" value=\"4\"/>",
            ),
        ),
        emitter("constant", SKY),
        emitter(
            "vmf",
            r#"<emitter type="vmf" id="sun"><vector name="direction" value="0.4, 1, 0.5"/><float name="kappa" value="5"/><rgb name="radiance" value="3, 2, 1"/></emitter>"#,
        ),
        emitter(
            "sphere light",
            r#"<shape type="sphere" id="bulb"><point name="center" value="0.5, 2, 0.5"/><float name="radius" value="0.4"/><bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf><emitter type="area"><rgb name="radiance" value="9, 8, 7"/></emitter></shape>"#,
        ),
        emitter(
            "point",
            r#"<emitter type="point" id="lamp"><point name="position" value="1, 2.5, 1"/><rgb name="intensity" value="9, 8, 7"/></emitter>"#,
        ),
        emitter(
            "directional",
            r#"<emitter type="directional" id="sun"><vector name="direction" value="-0.4, -1, -0.5"/><rgb name="irradiance" value="3, 2, 1"/></emitter>"#,
        ),
        emitter(
            "beam",
            r#"<shape type="disk" id="lamp"><transform name="to_world"><scale value="1.1"/><rotate x="1" angle="80"/><translate x="0.3" y="2.5" z="0.4"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf><emitter type="directionalarea"><rgb name="radiance" value="3, 2, 1"/></emitter></shape>"#,
        ),
        emitter(
            "projector",
            r#"<emitter type="projector" id="lamp"><transform name="to_world"><lookat origin="1, 2.5, 1" target="0, 0, 0" up="0, 0, 1"/></transform><float name="fov" value="60"/><float name="scale" value="1.5"/><texture name="irradiance" type="checkerboard"><rgb name="color0" value="0.7, 0.3, 0.2"/><rgb name="color1" value="0.2, 0.4, 0.6"/><transform name="to_uv"><scale value="5"/></transform></texture></emitter>"#,
        ),
        emitter(
            "slide",
            r#"<emitter type="spot" id="lamp"><transform name="to_world"><lookat origin="1, 2.5, 1" target="0, 0, 0" up="0, 0, 1"/></transform><float name="cutoff_angle" value="35"/><rgb name="intensity" value="9, 8, 7"/><texture name="texture" type="checkerboard"><rgb name="color0" value="0.7, 0.3, 0.2"/><rgb name="color1" value="0.2, 0.4, 0.6"/><transform name="to_uv"><scale value="5"/></transform></texture></emitter>"#,
        ),
        emitter(
            "spot",
            r#"<emitter type="spot" id="lamp"><transform name="to_world"><lookat origin="1, 2.5, 1" target="0, 0, 0" up="0, 0, 1"/></transform><float name="cutoff_angle" value="35"/><rgb name="intensity" value="9, 8, 7"/></emitter>"#,
        ),
    ]
}

/// Materials with a direction.
fn brushed() -> Vec<Case> {
    vec![
        material(
            "brushed metal",
            r#"<bsdf type="roughconductor"><string name="distribution" value="ggx"/><float name="alpha_u" value="0.35"/><float name="alpha_v" value="0.15"/><string name="material" value="Cu"/></bsdf>"#,
        ),
        material(
            "brushed principled",
            r#"<bsdf type="principled"><rgb name="base_color" value="0.7, 0.3, 0.2"/><float name="roughness" value="0.6"/><float name="metallic" value="0.5"/><float name="anisotropic" value="0.7"/></bsdf>"#,
        ),
        material(
            "brushed pane",
            r#"<bsdf type="principledthin"><rgb name="base_color" value="0.7, 0.5, 0.4"/><float name="roughness" value="0.6"/><float name="spec_trans" value="0.7"/><float name="anisotropic" value="0.7"/></bsdf>"#,
        ),
        material(
            "brushed glass",
            r#"<bsdf type="roughdielectric"><float name="alpha_u" value="0.2"/><float name="alpha_v" value="0.4"/><float name="int_ior" value="1.5"/></bsdf>"#,
        ),
    ]
}

/// Two lamps, one behind the other, that the camera looks through at a metal ball and a floor.
fn hidden_lamps() -> Case {
    let hide = r#"<boolean name="hide_emitters" value="true"/></integrator>"#;
    let ball = ball(r#"<bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf>"#);
    Case {
        name: "hidden lamps",
        body: format!(
            r#"{}{FLOOR}{ball}{SKY}<shape type="sphere" id="bulb"><point name="center" value="0.1, 0.9, 2"/>
            <float name="radius" value="0.3"/><bsdf type="diffuse"><rgb name="reflectance" value="0.3"/></bsdf>
            <emitter type="area"><rgb name="radiance" value="5, 4, 3"/></emitter></shape>
            <shape type="rectangle" id="panel"><transform name="to_world"><scale value="0.3"/><rotate x="1" angle="150"/>
            <translate x="-0.2" y="0.9" z="1.5"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0.2"/></bsdf>
            <emitter type="area"><rgb name="radiance" value="3, 4, 5"/></emitter></shape>"#,
            CAMERA.replace("</integrator>", hide)
        ),
    }
}
