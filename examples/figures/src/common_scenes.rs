//! Scenes that several figures render: a room, plates, a chess board and a tray. They come from code, in place of
//! assets that are not public.

use std::f64::consts::TAU;

use render::Scene;
use render::bsdf::Roughness;
use render::bsdf::microfacet::Ndf;

use examples::figure::Result;
use examples::scene_builder::{SceneBuilder, View, add, cross, dot, pixel, sub, unit};

/// A floor of this colour and a lamp three above it, which looks down and whose corner is at `x`: `floor` and `lamp`.
///
/// # Errors
/// Names that are taken.
pub fn lamp_above_floor(builder: &mut SceneBuilder, floor: [f64; 3], x: f64) -> Result<()> {
    let floor = builder.matt("floor", floor)?;
    let black = builder.matt("black", [0.0; 3])?;
    let corners = [[-4.0, 0.0, 4.0], [8.0, 0.0, 0.0], [0.0, 0.0, -8.0]];
    builder.quad("floor", corners, &floor)?;
    let corners = [[x, 3.0, -0.9], [1.2, 0.0, 0.0], [0.0, 0.0, 1.2]];
    let lamp = builder.quad("lamp", corners, &black)?;
    builder.lamp("lamp", lamp, [9.0, 10.0, 11.0])?;
    Ok(())
}

/// How what stands below that lamp is looked at.
pub fn below_lamp(size: u32) -> View {
    View {
        eye: [0.0, 3.0, 5.0],
        target: [0.0, 0.4, 0.0],
        fov: 45.0,
        size: [size; 2],
    }
}

/// What the walls of [`cornell`] are made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Walls {
    /// Diffuse.
    Matt,
    /// As [`Walls::Matt`], but the back wall is metal of roughness 0.15.
    GlossyBack,
}

/// Reflectances of floor, ceiling, back wall and blocks; of the left; of the right wall.
pub const CORNELL: [[f64; 3]; 3] = [[0.73; 3], [0.63, 0.065, 0.05], [0.14, 0.45, 0.09]];

/// Half the side of the lamp of [`cornell`], and its height.
pub const CORNELL_LAMP: [f64; 2] = [0.25, 0.98];

/// The room [-1, 1]^3, open to the front, with a lamp below the ceiling and two blocks. The walls are
/// `white`, `left` and `right`, the lamp `light`.
///
/// # Errors
/// None for a size above zero.
pub fn cornell(size: u32, walls: Walls, max_depth: u32) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let white = builder.matt("white", CORNELL[0])?;
    let left = builder.matt("left", CORNELL[1])?;
    let right = builder.matt("right", CORNELL[2])?;
    let black = builder.matt("black", [0.0; 3])?;
    let back = match walls {
        Walls::Matt => white.clone(),
        Walls::GlossyBack => builder.metal("back", [0.8; 3], 0.15)?,
    };
    let (x, y, z) = ([2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]);
    let minus = |v: [f64; 3]| v.map(|c| -c);
    builder.quad("floor", [[-1.0, -1.0, 1.0], x, minus(z)], &white)?;
    builder.quad("ceiling", [[-1.0, 1.0, -1.0], x, z], &white)?;
    builder.quad("back", [[-1.0, -1.0, -1.0], x, y], &back)?;
    builder.quad("left", [[-1.0, -1.0, 1.0], minus(z), y], &left)?;
    builder.quad("right", [[1.0, -1.0, -1.0], z, y], &right)?;
    builder.block("tall", [-0.35, -0.4, -0.3], [0.28, 0.6, 0.28], 18.0, &white)?;
    builder.block("short", [0.38, -0.7, 0.3], [0.28, 0.3, 0.28], -17.0, &white)?;
    let [half, height] = CORNELL_LAMP;
    let side = 2.0 * half;
    let at = [-half, height, -half];
    let light = builder.quad("light", [at, [side, 0.0, 0.0], [0.0, 0.0, side]], &black)?;
    builder.lamp("light", light, [17.0, 12.0, 7.0])?;
    let view = View {
        eye: [0.0, 0.0, 3.9],
        target: [0.0; 3],
        fov: 38.0,
        size: [size; 2],
    };
    builder.finish(&view, max_depth)
}

/// Radii of the lamps of [`Plates`], left to right.
pub const LAMP_RADII: [f64; 4] = [0.03, 0.1, 0.3, 0.9];
/// Roughness of the plates of [`Plates`], top to bottom.
pub const PLATE_ALPHAS: [f64; 4] = [0.005, 0.02, 0.05, 0.1];

/// Four glossy plates below four spherical lamps of equal power [Veach 1997, figure 9.2].
#[derive(Debug)]
pub struct Plates {
    /// The scene. Plates are `plate 0` to `plate 3`, lamps `lamp 0` to `lamp 3`, and a fill light.
    pub scene: Scene,
    /// Pixel at which plate i mirrors the centre of lamp j.
    pub cells: [[[f64; 2]; 4]; 4],
}

impl Plates {
    /// Top left corner and size of a window around the mirror image of lamp j in plate i, pixels: 1/32 of the width of the
    /// picture, half as high.
    pub fn window(&self, width: u32, i: usize, j: usize) -> [[u32; 2]; 2] {
        let (w, h) = ((width / 32).max(4), (width / 64).max(2));
        let [x, y] = self.cells[i][j];
        let low = |c: f64, n: u32| (c - 0.5 * f64::from(n)).round().max(0.0) as u32;
        [[low(x, w), low(y, h)], [w, h]]
    }
}

/// Positions of the lamps.
const LAMPS: [[f64; 3]; 4] = [
    [-3.75, 4.0, 0.0],
    [-1.25, 4.0, 0.0],
    [1.25, 4.0, 0.0],
    [3.75, 4.0, 0.0],
];

/// Centres of the plates.
const PLATES: [[f64; 3]; 4] = [
    [0.0, 0.1, -2.2],
    [0.0, -1.6, -0.9],
    [0.0, -3.0, 0.9],
    [0.0, -4.1, 3.0],
];

/// The scene of the plates, `width` x 3/4 `width` pixels. Every plate is tilted so that its centre mirrors
/// the middle of the row of lamps.
///
/// # Errors
/// None for a size above zero.
pub fn plates(width: u32) -> Result<Plates> {
    plates_of(width, PLATE_ALPHAS, Ndf::Ggx, true)
}

/// The same with other roughnesses, another distribution of normals, or all of them sampled.
///
/// # Errors
/// A roughness out of range.
pub fn plates_of(width: u32, alphas: [f64; 4], kind: Ndf, visible: bool) -> Result<Plates> {
    plates_with(width, |builder, name, i| {
        let roughness = builder.ggx(name, alphas[i])?;
        Ok(Roughness {
            kind,
            visible,
            ..roughness
        })
    })
}

/// The same with images of roughness around these means, all normals of a Beckmann distribution sampled.
///
/// # Errors
/// A roughness out of range.
pub fn textured_plates(width: u32, alphas: [f64; 4]) -> Result<Plates> {
    const SIDE: usize = 32;
    plates_with(width, |builder, name, i| {
        let wave = |k: usize, n: usize| (TAU * (n * k) as f64 / SIDE as f64).sin();
        let texel = |k: usize| alphas[i] * (1.0 + 0.4 * wave(k % SIDE, 6) * wave(k / SIDE, 1));
        let texels: Vec<f32> = (0..SIDE * SIDE).map(|k| texel(k) as f32).collect();
        builder.rough_texels(name, Ndf::Beckmann, &texels)
    })
}

fn plates_with(
    width: u32,
    finish: impl Fn(&mut SceneBuilder, &str, usize) -> Result<Roughness>,
) -> Result<Plates> {
    let view = View {
        eye: [0.0, 1.0, 16.0],
        target: [0.0, -0.4, 0.0],
        fov: 36.0,
        size: [width, width * 3 / 4],
    };
    let mut builder = SceneBuilder::default();
    let ground = builder.matt("ground", [0.25; 3])?;
    let black = builder.matt("black", [0.0; 3])?;
    let (x, z) = ([40.0, 0.0, 0.0], [0.0, 0.0, -40.0]);
    builder.quad("floor", [[-20.0, -5.2, 20.0], x, z], &ground)?;
    builder.quad("wall", [[-20.0, -5.2, -6.0], x, [0.0, 30.0, 0.0]], &ground)?;
    let mut cells = [[[0.0; 2]; 4]; 4];
    for (i, center) in PLATES.into_iter().enumerate() {
        let middle = [0.0, LAMPS[0][1], LAMPS[0][2]];
        let n = unit(add(
            unit(sub(middle, center)),
            unit(sub(view.eye, center)),
            1.0,
        ));
        // Along the plate, away from the lamps; the other side is x.
        let down = [0.0, -n[2], n[1]];
        let corner = add(add(center, [-1.0, 0.0, 0.0], 4.4), down, 0.6);
        let across = [8.8, 0.0, 0.0];
        let up = down.map(|c| -1.2 * c);
        let name = format!("plate {i}");
        let roughness = finish(&mut builder, &name, i)?;
        let metal = builder.metal_of(&name, [0.9; 3], roughness)?;
        builder.quad(&format!("plate {i}"), [corner, across, up], &metal)?;
        for (cell, lamp) in cells[i].iter_mut().zip(LAMPS) {
            let height = dot(sub(lamp, center), n);
            let image = add(lamp, n, -2.0 * height);
            let to = sub(image, view.eye);
            let t = dot(sub(center, view.eye), n) / dot(to, n);
            *cell = pixel(&view, add(view.eye, to, t));
        }
    }
    let tint = [
        [1.0, 0.75, 0.5],
        [1.0, 1.0, 0.6],
        [0.6, 1.0, 0.7],
        [0.6, 0.75, 1.0],
    ];
    for (j, (center, radius)) in LAMPS.into_iter().zip(LAMP_RADII).enumerate() {
        let ball = builder.ball(&format!("lamp {j}"), center, radius, &black)?;
        let power = tint[j].map(|c| 0.8 * c / (radius * radius));
        builder.lamp(&format!("lamp {j}"), ball, power)?;
    }
    // Behind the camera, for the floor.
    let fill = builder.ball("fill", [0.0, 12.0, 22.0], 2.0, &black)?;
    builder.lamp("fill", fill, [1.5; 3])?;
    Ok(Plates {
        scene: builder.finish(&view, 2)?,
        cells,
    })
}

/// Profile of a pawn, (radius, height), from the bottom up.
pub const PAWN: [[f64; 2]; 12] = [
    [0.0, 0.0],
    [0.32, 0.0],
    [0.32, 0.1],
    [0.24, 0.18],
    [0.14, 0.3],
    [0.1, 0.55],
    [0.2, 0.6],
    [0.1, 0.64],
    [0.17, 0.74],
    [0.17, 0.84],
    [0.1, 0.93],
    [0.0, 0.96],
];

/// Profile of a bishop.
pub const BISHOP: [[f64; 2]; 15] = [
    [0.0, 0.0],
    [0.38, 0.0],
    [0.38, 0.12],
    [0.28, 0.22],
    [0.16, 0.4],
    [0.11, 0.85],
    [0.25, 0.92],
    [0.13, 0.97],
    [0.2, 1.12],
    [0.21, 1.24],
    [0.13, 1.42],
    [0.05, 1.5],
    [0.08, 1.55],
    [0.05, 1.61],
    [0.0, 1.63],
];

/// Profile of a rook.
pub const ROOK: [[f64; 2]; 12] = [
    [0.0, 0.0],
    [0.38, 0.0],
    [0.38, 0.14],
    [0.28, 0.24],
    [0.2, 0.4],
    [0.17, 0.85],
    [0.28, 0.92],
    [0.28, 1.16],
    [0.18, 1.16],
    [0.18, 1.04],
    [0.06, 1.04],
    [0.0, 1.04],
];

/// A table of metal of this roughness, `table`, above a matt floor, `floor`.
///
/// # Errors
/// None for a roughness that metals have.
pub fn table(builder: &mut SceneBuilder, alpha: f64) -> Result {
    let floor = builder.matt("floor", [0.35, 0.32, 0.3])?;
    let table = builder.metal("table", [0.7, 0.62, 0.5], alpha)?;
    let flat = |half: f64, y: f64| {
        let side = 2.0 * half;
        [[-half, y, half], [side, 0.0, 0.0], [0.0, 0.0, -side]]
    };
    builder.quad("floor", flat(12.0, -0.6), &floor)?;
    builder.quad("table", flat(2.0, 0.0), &table)?;
    Ok(())
}

/// A board with a bishop, a rook and pawns on a floor, under one lamp and dim ambient light. The
/// materials are `floor`, `table`, `bishop`, `rook` and `pawn`.
///
/// # Errors
/// None for a size above zero.
pub fn chess(size: [u32; 2], max_depth: u32) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    table(&mut builder, 0.25)?;
    let bishop = builder.matt("bishop", [0.6, 0.25, 0.15])?;
    let rook = builder.matt("rook", [0.75, 0.72, 0.65])?;
    let pawn = builder.matt("pawn", [0.25, 0.3, 0.4])?;
    let black = builder.matt("black", [0.0; 3])?;
    builder.turned("bishop", &BISHOP, [-0.25, 0.0, 0.35], &bishop)?;
    builder.turned("rook", &ROOK, [0.85, 0.0, -0.3], &rook)?;
    for at in [[-1.1, 0.0, -0.4], [0.2, 0.0, -0.9], [0.75, 0.0, 0.75]] {
        builder.turned("pawn", &PAWN, at, &pawn)?;
    }
    let sides = [[1.6, 0.0, 0.0], [0.0, 0.0, 1.6]];
    let light = builder.quad("light", [[-2.6, 4.0, -0.4], sides[0], sides[1]], &black)?;
    builder.lamp("light", light, [14.0, 13.0, 11.0])?;
    builder.ambient([0.15, 0.17, 0.2])?;
    let view = View {
        eye: [0.6, 2.4, 5.2],
        target: [0.05, 0.55, 0.0],
        fov: 30.0,
        size,
    };
    builder.finish(&view, max_depth)
}

/// The things on the table of [`tray`], and their roughness.
pub const TRAY: [(&str, f64); 6] = [
    ("table", 0.3),
    ("tray", 0.02),
    ("pitcher", 0.04),
    ("jug", 0.1),
    ("cup", 0.2),
    ("frame", 0.03),
];
/// Middle, half side and radiance of the lamps above [`tray`].
pub const TRAY_LAMPS: [([f64; 3], f64, [f64; 3]); 2] = [
    ([-1.6, 2.3, 1.2], 0.25, [24.0, 21.0, 16.0]),
    ([1.5, 2.1, -0.6], 0.15, [40.0, 44.0, 52.0]),
];

/// Profile of the tray.
const DISH: [[f64; 2]; 6] = [
    [0.0, 0.0],
    [0.95, 0.0],
    [1.1, 0.09],
    [1.06, 0.1],
    [0.93, 0.03],
    [0.0, 0.03],
];

/// Profile of pitcher and jug.
const PITCHER: [[f64; 2]; 9] = [
    [0.0, 0.0],
    [0.22, 0.0],
    [0.31, 0.16],
    [0.29, 0.38],
    [0.17, 0.58],
    [0.21, 0.74],
    [0.18, 0.74],
    [0.14, 0.58],
    [0.0, 0.5],
];

/// Profile of the cup.
const CUP: [[f64; 2]; 6] = [
    [0.0, 0.0],
    [0.12, 0.0],
    [0.2, 0.26],
    [0.18, 0.26],
    [0.11, 0.03],
    [0.0, 0.03],
];

/// A table with things of metal that reflect each other, [`TRAY`], below two small lamps in a dim hall.
/// The smooth ones are Beckmann, the others GGX. All normals are sampled, as in the thesis.
///
/// # Errors
/// None for a size above zero.
pub fn tray(size: [u32; 2], max_depth: u32) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let colours = [
        [0.55, 0.42, 0.32],
        [0.92, 0.92, 0.9],
        [0.95, 0.78, 0.45],
        [0.9, 0.6, 0.5],
        [0.85, 0.88, 0.9],
        [0.9, 0.9, 0.92],
    ];
    let mut metals = Vec::new();
    for ((name, alpha), colour) in TRAY.into_iter().zip(colours) {
        let mut roughness = builder.ggx(name, alpha)?;
        roughness.visible = false;
        if alpha < 0.05 {
            roughness.kind = Ndf::Beckmann;
        }
        metals.push(builder.metal_of(name, colour, roughness)?);
    }
    let [table, dish, pitcher, jug, cup, frame] = &metals[..] else {
        return Err("one metal for each thing".into());
    };
    let black = builder.matt("black", [0.0; 3])?;
    let half = 2.5;
    let (x, z) = ([2.0 * half, 0.0, 0.0], [0.0, 0.0, -2.0 * half]);
    builder.quad("table", [[-half, 0.0, half], x, z], table)?;
    // Slightly above the table: where surfaces meet, their line of contact is an edge that neither shape reports.
    builder.turned("tray", &DISH, [0.1, 0.002, 0.3], dish)?;
    builder.turned("pitcher", &PITCHER, [-0.3, 0.034, 0.15], pitcher)?;
    builder.turned("cup", &CUP, [0.45, 0.034, 0.65], cup)?;
    builder.turned("jug", &PITCHER, [1.35, 0.002, -0.5], jug)?;
    let (across, up) = ([1.3, 0.0, 0.3], [0.0, 1.0, -0.3]);
    builder.quad("frame", [[-1.5, 0.002, -0.9], across, up], frame)?;
    for (k, (at, half, radiance)) in TRAY_LAMPS.into_iter().enumerate() {
        let n = unit(sub([0.0, 0.3, 0.0], at));
        let s = unit(cross([0.0, 1.0, 0.0], n));
        let sides = [s, cross(n, s)].map(|v| v.map(|c| 2.0 * half * c));
        let corner = add(add(at, sides[0], -0.5), sides[1], -0.5);
        let name = format!("lamp {k}");
        let lamp = builder.quad(&name, [corner, sides[0], sides[1]], &black)?;
        builder.lamp(&name, lamp, radiance)?;
    }
    builder.hall(0.1)?;
    let view = View {
        eye: [0.1, 1.9, 3.6],
        target: [0.1, 0.28, 0.0],
        fov: 30.0,
        size,
    };
    builder.finish(&view, max_depth)
}
