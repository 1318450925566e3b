//! Normal maps of fine detail, and metal under them.

use std::sync::Arc;

use render::bsdf::{Conductor, Interpolation, Material, NormalMap};
use render::sampler::mix64;
use render::scene::Builder;
use render::texture::RgbTexture;

use examples::figure::Result;

/// Slopes of a normal map, row by row.
pub struct Slopes {
    /// Texels of a side.
    pub n: usize,
    /// Both slopes of each texel.
    pub texels: Vec<[f64; 2]>,
}

/// A number in [0, 1).
fn number(seed: u64, i: u64) -> f64 {
    (mix64(mix64(seed) ^ i) >> 11) as f64 / (1u64 << 53) as f64
}

impl Slopes {
    /// Of a Gaussian height field with this deviation of slopes: white noise, smoothed over five texels, which repeats.
    pub fn gaussian(n: usize, deviation: f64, seed: u64) -> Self {
        Self::of_noise(n, deviation, seed, [1, 1])
    }

    /// Of brushed metal: the same, smoothed over many more texels along a row than along a column.
    pub fn brushed(n: usize, deviation: f64, seed: u64) -> Self {
        Self::of_noise(n, deviation, seed, [64, 1])
    }

    /// Of white noise, smoothed so often over five texels along a row and along a column.
    fn of_noise(n: usize, deviation: f64, seed: u64, [along, across]: [usize; 2]) -> Self {
        let height: Vec<f64> = (0..(n * n) as u64).map(|i| number(seed, i) - 0.5).collect();
        let smooth = |h: &[f64], row: bool| -> Vec<f64> {
            let weights = [1.0, 4.0, 6.0, 4.0, 1.0];
            let at = |i: usize, k: usize| {
                let (x, y) = (i % n, i / n);
                let moved = |c: usize| (c + n + k - 2) % n;
                if row {
                    y * n + moved(x)
                } else {
                    moved(y) * n + x
                }
            };
            (0..n * n)
                .map(|i| (0..5).map(|k| weights[k] * h[at(i, k)]).sum::<f64>() / 16.0)
                .collect()
        };
        let rows = (0..along).fold(height, |h, _| smooth(&h, true));
        let height = (0..across).fold(rows, |h, _| smooth(&h, false));
        let at = |x: usize, y: usize| height[(y % n) * n + x % n];
        let slope = |i: usize| {
            let (x, y) = (i % n, i / n);
            [
                at(x + 1, y) - at(x + n - 1, y),
                at(x, y + 1) - at(x, y + n - 1),
            ]
        };
        let mut texels: Vec<[f64; 2]> = (0..n * n).map(slope).collect();
        let squares = texels.iter().flatten().map(|s| s * s).sum::<f64>();
        let scale = deviation / (squares / (2 * n * n) as f64).sqrt();
        for s in texels.iter_mut().flatten() {
            *s *= scale;
        }
        Self { n, texels }
    }

    /// Of a flat surface with straight scratches of this half width, in texels, whose sides are this steep.
    pub fn scratched(n: usize, count: u64, half_width: f64, steep: f64, seed: u64) -> Self {
        let mut texels = vec![[0.0; 2]; n * n];
        let size = n as f64;
        for k in 0..count {
            let u = |i: u64| number(seed, 8 * k + i);
            let (sin, cos) = (std::f64::consts::PI * u(0)).sin_cos();
            let middle = [size * u(1), size * u(2)];
            let half_length = size * (0.1 + 0.25 * u(3));
            let reach = (half_length + half_width).ceil() as i64;
            for dy in -reach..=reach {
                for dx in -reach..=reach {
                    let at = [middle[0].floor() + dx as f64, middle[1].floor() + dy as f64];
                    let off = [at[0] - middle[0], at[1] - middle[1]];
                    let (along, across) =
                        (off[0] * cos + off[1] * sin, off[1] * cos - off[0] * sin);
                    if along.abs() > half_length || across.abs() > half_width {
                        continue;
                    }
                    let slope = steep * (std::f64::consts::PI * across / half_width).sin();
                    let [x, y] = at.map(|c| (c as i64).rem_euclid(n as i64) as usize);
                    texels[y * n + x] = [-slope * sin, slope * cos];
                }
            }
        }
        Self { n, texels }
    }

    /// A metal under this map, repeated so many times.
    ///
    /// # Errors
    /// None that a map of the above can cause.
    pub fn metal(&self, build: &mut Builder, tiles: f32) -> Result<NormalMap> {
        let metal = Material::from(smooth_metal(build)?);
        self.over(build, tiles, metal)
    }

    /// A material under this map, repeated so many times.
    ///
    /// # Errors
    /// None that a map of the above can cause.
    pub fn over(&self, build: &mut Builder, tiles: f32, nested: Material) -> Result<NormalMap> {
        let encode = |&[x, y]: &[f64; 2]| {
            let z = (1.0 + x * x + y * y).sqrt().recip();
            [-x * z, -y * z, z].map(|c| (0.5 * c + 0.5) as f32)
        };
        let texels: Vec<f32> = self.texels.iter().flat_map(encode).collect();
        let size = [self.n as u32; 2];
        let mut map = build.texels("normals", size, &texels, (-1.0, 2.0))?;
        if let RgbTexture::Bitmap(b) = &mut map {
            b.to_uv.rows[0][0] = tiles;
            b.to_uv.rows[1][1] = tiles;
        }
        Ok(NormalMap::new(
            map,
            Interpolation::Slopes,
            Arc::new(nested),
        )?)
    }
}

/// Smooth metal.
///
/// # Errors
/// None that the constants here can cause.
pub fn smooth_metal(build: &mut Builder) -> Result<Conductor> {
    Ok(Conductor {
        specular_reflectance: build.rgb(
            "metal.specular_reflectance.value",
            [0.9; 3],
            (0.0, 1.0),
        )?,
        index: None,
    })
}
