//! A scene from code, to begin with: it needs no file.

use super::load::MAX_PIXELS;
use super::{Builder, Scene, Settings};
use crate::bsdf::microfacet::Ndf;
use crate::bsdf::{Conductor, Diffuse, RoughConductor, Roughness};
use crate::camera::{Camera, FovAxis};
use crate::emitter::Area;
use crate::error::SceneError;
use crate::film::Film;
use crate::math::Transform;
use crate::shape::{AnyShape, Cube, Patch, Rectangle, Sphere};

/// The room [-1, 1]^3 with coloured walls on the left and right, a lamp in the ceiling, a matt block,
/// and a sphere of rough metal: what `recover` looks into where it is given no scene.
///
/// ```
/// let room = render::scene::room(64, 64)?;
/// assert_eq!(room.params().get("left.reflectance.value")?, [0.62, 0.11, 0.08]);
/// assert!(render::scene::room(0, 64).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// A size of zero, or beyond that of scene files.
pub fn room(width: u32, height: u32) -> Result<Scene, SceneError> {
    let pixels = width as usize * height as usize;
    if pixels == 0 || pixels > MAX_PIXELS {
        return Err(SceneError::Parameter {
            key: "size".into(),
            expected: format!("1 to {MAX_PIXELS} pixels"),
            found: format!("{width} x {height}"),
        });
    }
    let mut b = Builder::new();
    let unit = (0.0, 1.0);
    let diffuse = |b: &mut Builder, name: &str, colour| -> Result<_, SceneError> {
        let reflectance = b.rgb(&format!("{name}.reflectance.value"), colour, unit)?;
        Ok(b.add_material(Diffuse { reflectance }))
    };
    let white = diffuse(&mut b, "white", [0.73, 0.72, 0.69])?;
    let left = diffuse(&mut b, "left", [0.62, 0.11, 0.08])?;
    let right = diffuse(&mut b, "right", [0.12, 0.42, 0.2])?;
    let black = diffuse(&mut b, "black", [0.0; 3])?;
    let metal = RoughConductor {
        roughness: Roughness {
            kind: Ndf::Ggx,
            alpha: b.scalar("sphere.alpha.value", 0.2, (1e-4, 1.0))?,
            visible: true,
        },
        conductor: Conductor {
            specular_reflectance: b.rgb("sphere.specular_reflectance.value", [0.9; 3], unit)?,
            index: None,
        },
    };
    let metal = b.add_material(metal);

    let (x, y, z) = ([2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]);
    let back = |v: [f64; 3]| v.map(|c| -c);
    b.add_shape("floor", quad([-1.0, -1.0, 1.0], x, back(z))?, white);
    b.add_shape("ceiling", quad([-1.0, 1.0, -1.0], x, z)?, white);
    b.add_shape("back", quad([-1.0, -1.0, -1.0], x, y)?, white);
    b.add_shape("left", quad([-1.0, -1.0, 1.0], back(z), y)?, left);
    b.add_shape("right", quad([1.0, -1.0, -1.0], z, y)?, right);
    let ball = Sphere::new([0.4, -0.6, 0.25], 0.4, false);
    b.add_shape("sphere", whole(ball, "sphere")?, metal);
    let turned = Transform::scale([0.28, 0.55, 0.28])
        .then(&Transform::rotate([0.0, 1.0, 0.0], 20.0).unwrap_or_default())
        .then(&Transform::translate([-0.42, -0.45, -0.3]));
    b.add_shape("block", whole(Cube::new(&turned, false), "block")?, white);
    let lamp = quad([-0.3, 0.995, -0.3], [0.6, 0.0, 0.0], [0.0, 0.0, 0.6])?;
    let shape = b.add_shape("light", lamp, black);
    let radiance = b.rgb(
        "light.emitter.radiance.value",
        [14.0, 11.0, 7.0],
        (0.0, f64::INFINITY),
    )?;
    let light = Area {
        radiance,
        exponent: 0.0,
        shape,
    };
    b.add_emitter(light, Some(shape));

    let view = Transform::look_at([0.0, 0.0, 3.9], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    let camera = Camera::new(
        view.unwrap_or_default(),
        38.0,
        FovAxis::Smaller,
        [width, height],
    )?;
    let settings = Settings {
        max_depth: 6,
        rr_depth: 5,
        spp: 64,
        ..Settings::default()
    };
    b.build(camera, Film::new(width, height), settings)
}

fn quad(corner: [f64; 3], e1: [f64; 3], e2: [f64; 3]) -> Result<AnyShape, SceneError> {
    whole(
        Patch::new(corner, e1, e2, false).map(Rectangle),
        "rectangle",
    )
}

/// The shape, or an error where it is degenerate.
fn whole<S: Into<AnyShape>>(shape: Option<S>, name: &str) -> Result<AnyShape, SceneError> {
    shape.map(Into::into).ok_or_else(|| SceneError::Parameter {
        key: name.into(),
        expected: "a finite shape with an area".into(),
        found: "none".into(),
    })
}
