//! Images that begin coarse and become finer.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::error::{OptimError, require};
use crate::scalar::Scalar;

/// A change of variables for the texels of an image, `[height][width][channels]`: they are those of a coarser image,
/// interpolated, whose resolution doubles every so many steps until it is that of the image itself. What is large is found
/// before what is small, and the local minima of fine detail are not there at first [Zeltner 2021, figure 4.25].
///
/// All texels of a coarse one share its variable. Texels lie at the centres of their cells; the border's value continues
/// beyond it. Interpolated values stay within the bounds of the coarse ones. When the resolution doubles, each variable
/// becomes the mean of the texels that it is for from now on: the image changes a little.
///
/// ```
/// use optim::{Coarse, Constrained, Groups, Optimizer, Parameterisation, Sgd};
///
/// // An image of four by two texels, begun with two texels along its longer side; two steps later with all.
/// let image = Coarse::new([4, 2], 1, 2, 2)?;
/// assert_eq!([image.resolution(0), image.resolution(2)], [[2, 1], [4, 2]]); // columns and rows
/// let mut groups = Groups::new(8); // [height][width][channels]
/// groups.add("wood.reflectance.data", 0..8, Parameterisation::Identity)?;
/// groups.coarsen("wood.reflectance.data", image)?;
/// let mut optimizer = Constrained::new(Sgd::new(8, 0.1)?, groups)?;
/// let (mut texels, mut gradient) = ([0.5f64; 8], [0.0; 8]);
/// gradient[0] = -1.0; // one texel alone
/// optimizer.step(&mut texels, &gradient)?;
/// assert_eq!(texels[0], texels[4]); // both rows are one at first
/// # Ok::<(), optim::OptimError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawCoarse")]
pub struct Coarse {
    size: [usize; 2],
    channels: usize,
    start: usize,
    every: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawCoarse {
    size: [usize; 2],
    channels: usize,
    start: usize,
    every: u64,
}

impl TryFrom<RawCoarse> for Coarse {
    type Error = OptimError;
    fn try_from(raw: RawCoarse) -> Result<Self, OptimError> {
        Self::new(raw.size, raw.channels, raw.start, raw.every)
    }
}

/// An axis of an image at some resolution: cells of texels, and where texels lie between the centres of cells.
struct Axis {
    cells: Vec<Range<usize>>,
    /// Per texel: its cell, the two cells around it, and the weight of the second.
    texels: Vec<(usize, [usize; 2], f64)>,
}

impl Axis {
    fn new(texels: usize, cells: usize) -> Self {
        let first = |cell: usize| (cell * texels).div_ceil(cells);
        let place = |i: usize| {
            let x = (i as f64 + 0.5) * cells as f64 / texels as f64 - 0.5;
            let x = x.clamp(0.0, (cells - 1) as f64);
            let low = (x as usize).min(cells - 1);
            (
                i * cells / texels,
                [low, (low + 1).min(cells - 1)],
                x - low as f64,
            )
        };
        Self {
            cells: (0..cells).map(|c| first(c)..first(c + 1)).collect(),
            texels: (0..texels).map(place).collect(),
        }
    }
}

impl Coarse {
    /// For images of `size`, columns and rows: with `start` texels along the longer side at first, and twice as many after
    /// every `every` steps.
    ///
    /// # Errors
    /// No texels, no channels, or zero for one of the others.
    pub fn new(
        size: [usize; 2],
        channels: usize,
        start: usize,
        every: u64,
    ) -> Result<Self, OptimError> {
        let counts = [
            ("image", size[0].min(size[1]) as u64),
            ("channels", channels as u64),
            ("coarse resolution", start as u64),
            ("steps of a resolution", every),
        ];
        for (what, found) in counts {
            require(found > 0, what, "at least 1", found as f64)?;
        }
        Ok(Self {
            size,
            channels,
            start,
            every,
        })
    }

    /// How many numbers the image has.
    pub(crate) fn len(&self) -> usize {
        self.size[0] * self.size[1] * self.channels
    }

    /// Columns and rows at a step.
    pub fn resolution(&self, step: u64) -> [usize; 2] {
        let longer = self.size[0].max(self.size[1]);
        let doublings = (step / self.every).min(u64::from(usize::BITS - 1)) as u32;
        let side =
            (self.start.checked_mul(1 << doublings.min(40))).map_or(longer, |s| s.min(longer));
        self.size.map(|n| (n * side).div_ceil(longer).clamp(1, n))
    }

    /// The axes at a step; `None` once the resolution is the image's own.
    fn axes(&self, step: u64) -> Option<[Axis; 2]> {
        let [columns, rows] = self.resolution(step);
        ([columns, rows] != self.size).then(|| {
            [
                Axis::new(self.size[0], columns),
                Axis::new(self.size[1], rows),
            ]
        })
    }

    /// Texels of the coarse image, with those of the image itself that lie in each.
    fn cells(&self, [x, y]: &[Axis; 2], mut f: impl FnMut(usize, &mut dyn Iterator<Item = usize>)) {
        let width = self.size[0];
        for (j, rows) in y.cells.iter().enumerate() {
            for (i, columns) in x.cells.iter().enumerate() {
                let mut texels = (rows.clone())
                    .flat_map(|row| columns.clone().map(move |column| row * width + column));
                f(j * x.cells.len() + i, &mut texels);
            }
        }
    }

    /// Each texel with the four coarse ones around it and their weights.
    fn interpolated([x, y]: &[Axis; 2], mut f: impl FnMut(usize, [(usize, f64); 4])) {
        let stride = x.cells.len();
        for (j, &(_, [y0, y1], fy)) in y.texels.iter().enumerate() {
            for (i, &(_, [x0, x1], fx)) in x.texels.iter().enumerate() {
                let corners = [
                    (y0 * stride + x0, (1.0 - fx) * (1.0 - fy)),
                    (y0 * stride + x1, fx * (1.0 - fy)),
                    (y1 * stride + x0, (1.0 - fx) * fy),
                    (y1 * stride + x1, fx * fy),
                ];
                f(j * x.texels.len() + i, corners);
            }
        }
    }

    /// The image that coarse texels make, each of which all of its texels hold.
    pub(crate) fn values<T: Scalar>(&self, step: u64, image: &mut [T]) {
        let Some(axes) = self.axes(step) else {
            return;
        };
        let channels = self.channels;
        let mut coarse = Vec::new();
        self.cells(&axes, |_, texels| {
            let first = texels.next().unwrap_or(0);
            coarse.extend_from_slice(&image[first * channels..][..channels]);
        });
        Self::interpolated(&axes, |texel, corners| {
            for c in 0..channels {
                let mut sum = 0.0;
                for (cell, w) in corners {
                    sum += w * coarse[cell * channels + c].to_f64();
                }
                image[texel * channels + c] = T::from_f64(sum);
            }
        });
    }

    /// The derivative by coarse texels, in each of theirs, in place of that by the texels: the transpose of
    /// [`Coarse::values`].
    pub(crate) fn pull_back<T: Scalar>(&self, step: u64, gradient: &mut [T]) {
        let Some(axes) = self.axes(step) else {
            return;
        };
        let channels = self.channels;
        let mut sums = vec![0.0; axes[0].cells.len() * axes[1].cells.len() * channels];
        Self::interpolated(&axes, |texel, corners| {
            for c in 0..channels {
                let g = gradient[texel * channels + c].to_f64();
                for (cell, w) in corners {
                    sums[cell * channels + c] += w * g;
                }
            }
        });
        self.spread(&axes, &sums, gradient);
    }

    /// Makes each coarse texel the mean of its texels.
    pub(crate) fn variables<T: Scalar>(&self, step: u64, image: &mut [T]) {
        let Some(axes) = self.axes(step) else {
            return;
        };
        let channels = self.channels;
        let mut means = vec![0.0; axes[0].cells.len() * axes[1].cells.len() * channels];
        self.cells(&axes, |cell, texels| {
            let (own, mut count) = (&mut means[cell * channels..][..channels], 0.0);
            for texel in texels {
                count += 1.0;
                for (c, mean) in own.iter_mut().enumerate() {
                    *mean += image[texel * channels + c].to_f64();
                }
            }
            own.iter_mut().for_each(|mean| *mean /= count);
        });
        self.spread(&axes, &means, image);
    }

    fn spread<T: Scalar>(&self, axes: &[Axis; 2], coarse: &[f64], image: &mut [T]) {
        let channels = self.channels;
        self.cells(axes, |cell, texels| {
            for texel in texels {
                for c in 0..channels {
                    image[texel * channels + c] = T::from_f64(coarse[cell * channels + c]);
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Adam, Constrained, Groups, Optimizer, Parameterisation};
    use approx::assert_relative_eq;

    #[test]
    fn resolutions_double() {
        let c = Coarse::new([24, 6], 1, 4, 10).unwrap();
        let at = |step| c.resolution(step);
        assert_eq!(
            [at(0), at(9), at(10), at(20), at(30)],
            [[4, 1], [4, 1], [8, 2], [16, 4], [24, 6]]
        );
        assert_eq!(at(u64::MAX), [24, 6]);
        for (size, channels, start, every) in [
            ([0, 3], 1, 1, 1),
            ([3, 3], 0, 1, 1),
            ([3, 3], 1, 0, 1),
            ([3, 3], 1, 1, 0),
        ] {
            assert!(Coarse::new(size, channels, start, every).is_err());
        }
    }

    #[test]
    fn pulling_back_is_the_transpose_of_values() {
        let c = Coarse::new([7, 5], 2, 3, 4).unwrap();
        for step in [0, 4] {
            let mut direction: Vec<f64> = (0..70).map(|i| f64::from(i * 7 % 11) - 5.0).collect();
            c.variables(step, &mut direction);
            let adjoint: Vec<f64> = (0..70).map(|i| f64::from(i).sin()).collect();
            let mut image = direction.clone();
            c.values(step, &mut image);
            let forward: f64 = image.iter().zip(&adjoint).map(|(x, a)| x * a).sum();
            let mut pulled = adjoint.clone();
            c.pull_back(step, &mut pulled);
            // Each coarse texel once.
            let mut reverse = 0.0;
            c.cells(&c.axes(step).unwrap(), |_, texels| {
                let first = texels.next().unwrap();
                reverse += (0..2)
                    .map(|k| direction[2 * first + k] * pulled[2 * first + k])
                    .sum::<f64>();
            });
            assert_relative_eq!(forward, reverse, epsilon = 1e-12);
        }
        let mut image: Vec<f64> = (0..70).map(f64::from).collect();
        c.values(8, &mut image);
        assert!((0..70).all(|i| image[i] == i as f64), "its own resolution");
        let mut flat = vec![0.25f64; 70];
        c.values(0, &mut flat);
        assert!(flat.iter().all(|x| (x - 0.25).abs() < 1e-15));
    }

    /// A fine image is found, coarse at first, within its bounds; what was read back goes on bit by bit.
    #[test]
    fn an_image_is_found_from_coarse_to_fine() {
        let side = 16;
        let truth: Vec<f64> = (0..side * side)
            .map(|i| {
                if (i % side + i / side) % 5 == 0 {
                    1.0
                } else {
                    0.25
                }
            })
            .collect();
        let mut groups = Groups::new(side * side);
        let bounded = Parameterisation::bounded(0.0, 1.0).unwrap();
        groups.add("t", 0..side * side, bounded).unwrap();
        let coarse = Coarse::new([side, side], 1, 2, 20).unwrap();
        groups.coarsen("t", coarse.clone()).unwrap();
        let mut o = Constrained::new(Adam::new(side * side, 0.05).unwrap(), groups).unwrap();
        let mut p = vec![0.5f64; side * side];
        let mut roughness = Vec::new();
        for step in 0..160 {
            let g: Vec<f64> = p.iter().zip(&truth).map(|(p, t)| p - t).collect();
            o.step(&mut p, &g).unwrap();
            assert!(p.iter().all(|p| (0.0..=1.0).contains(p)));
            if step % 20 == 19 {
                roughness.push(p.windows(2).map(|w| (w[1] - w[0]).abs()).sum::<f64>());
            }
            if step == 30 {
                let text = serde_json::to_string(&o).unwrap();
                assert_eq!(
                    serde_json::from_str::<Constrained<_, f64>>(&text).unwrap(),
                    o
                );
            }
        }
        assert!(roughness[0] < 0.5 * roughness[3], "{roughness:?}");
        let error = p
            .iter()
            .zip(&truth)
            .fold(0.0, |e: f64, (p, t)| e.max((p - t).abs()));
        assert!(error < 1e-2, "{error}");
    }

    #[test]
    fn what_is_no_image_is_named() {
        let mut groups = Groups::new(12);
        groups.add("t", 0..12, Parameterisation::Identity).unwrap();
        let wrong = groups.coarsen("t", Coarse::new([3, 3], 1, 1, 1).unwrap());
        assert_eq!(
            wrong.unwrap_err().to_string(),
            "group `t`: expected 9 entries, those of the image, found 12"
        );
        groups
            .coarsen("t", Coarse::new([3, 4], 1, 1, 1).unwrap())
            .unwrap();
        let rates = crate::Rates::new(12, 1.0).unwrap();
        let refused = crate::GaussNewton::<f32>::new(rates, groups, Default::default());
        assert!(refused.unwrap_err().to_string().contains("Gauss-Newton"));
    }
}
