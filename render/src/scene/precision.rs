//! What single precision does not resolve: shapes far from the origin, and surfaces that are close together.

use std::sync::Arc;

use super::builder::Builder;
use crate::accel::{layers, sheets};
use crate::bsdf::nesting;
use crate::error::quoted;
use crate::plugin::Node;
use crate::shape::{AnyShape, Shape};

/// Shapes smaller than so many roundings of their coordinates are not seen as they are: rays that leave a surface
/// start some way off it, and what is near is lit by a few percent too much or too little.
const FEWEST_ROUNDINGS: f64 = 1024.0;
/// Triangles smaller than so many have normals of their own making.
const FEWEST_ROUNDINGS_OF_TRIANGLES: f64 = 16.0;

/// Warns of shapes far from the origin that are too small for single precision there: of the worst one, with the number
/// of the others. `nodes` are those of the builder's shapes.
pub(super) fn warn_of_coordinates(nodes: &[&Arc<Node>], build: &Builder) {
    let mut worst: Option<(f64, &AnyShape, &Node)> = None;
    let mut count = 0;
    for (shape, &node) in build.shapes().iter().zip(nodes) {
        let rounding = rounding(shape);
        let mut roundings = shape.area().sqrt() / rounding / FEWEST_ROUNDINGS;
        if let Some(size) = size_of_triangles(shape) {
            roundings = roundings.min(size / rounding / FEWEST_ROUNDINGS_OF_TRIANGLES);
        }
        if roundings < 1.0 {
            count += 1;
            if worst.is_none_or(|(least, ..)| roundings < least) {
                worst = Some((roundings, shape, node));
            }
        }
    }
    let Some((_, shape, node)) = worst else {
        return;
    };
    let name = node.id.as_deref().map(|id| format!("{} ", quoted(id)));
    let triangles = size_of_triangles(shape).map(|s| format!(", with triangles of {s:.1e}"));
    let others = match count - 1 {
        0 => String::new(),
        more => format!("; so it is with {more} more shapes"),
    };
    node.warn(format!(
        "{}about {:.1e} large{} is too small for coordinates of {:.1e}, which single precision resolves to {:.1e}: \
         its light will be wrong by percents{others}. Move the scene to the origin",
        name.unwrap_or_default(),
        shape.area().sqrt(),
        triangles.unwrap_or_default(),
        shape.extent(),
        2.0 * rounding(shape),
    ));
}

/// Largest rounding of a shape's coordinates.
fn rounding(shape: &AnyShape) -> f64 {
    f64::from(shape.extent()) * f64::from(f32::EPSILON) / 2.0
}

/// About as long as the sides of the triangles of a mesh.
fn size_of_triangles(shape: &AnyShape) -> Option<f64> {
    let mesh = match shape {
        AnyShape::Mesh(mesh) => mesh,
        AnyShape::Instance(instance) => instance.mesh(),
        _ => return None,
    };
    Some((2.0 * shape.area() / mesh.data().triangles.len() as f64).sqrt())
}

/// Warns of flat surfaces that are one to rays and of which one lets light through: what passes it does not meet the
/// other. Lamps are raised above what they lie on. `nodes` are those of the builder's shapes.
pub(super) fn warn_of_layers(nodes: &[&Arc<Node>], build: &Builder) {
    let passed = |shape: usize| nesting::lets_light_through(build.material_of(shape));
    if !(0..nodes.len()).any(passed) {
        return;
    }
    let (mut all, mut shapes) = (Vec::new(), Vec::new());
    for (i, shape) in build.shapes().iter().enumerate() {
        // The planes of triangles of instances are known to their mesh alone, and curves have none.
        let planeless = matches!(shape, AnyShape::Instance(_) | AnyShape::Curves(_));
        if !planeless && build.emitter_of(i).is_none() {
            all.extend(sheets(&shape.primitives()));
            shapes.resize(all.len(), i);
        }
    }
    let matters = |i: usize, k: usize| passed(shapes[i]) || passed(shapes[k]);
    let Some(found) = layers(&all, matters) else {
        return;
    };
    let [first, second] = found.map(|i| shapes[i]);
    let with = if first == second {
        "itself".into()
    } else {
        let node = nodes[first];
        format!("{} at {}", node.describe(), node.location)
    };
    nodes[second].warn(format!(
        "lies on one plane with {with}, as far as single precision tells at coordinates of {:.1e}, and light that passes \
         one of the two does not meet the other: expected more than {:.1e} between them",
        build.shapes()[second].extent(),
        2.0 * all[found[1]].apart(),
    ));
}
