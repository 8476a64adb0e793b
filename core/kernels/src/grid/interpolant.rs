//! The field between the nodes: a C2 cubic B-spline near the node values.
//!
//! Along each axis the coefficients are c = f - (second difference of f) / 6, which reproduces cubics and is of fourth
//! order without a global solve (de Boor's quasi-interpolant; P. Thevenaz, T. Blu, M. Unser, IEEE Trans. Medical Imaging
//! 19 (2000) 739). Prefilter and B-splines together weigh six nodes an axis. Beyond the grid, values go on linearly,
//! so that linear functions are reproduced up to the border.

use multiversion::multiversion;
use rayon::prelude::*;

use super::blocks::{Blocks, Neighbor, SIDE};
use crate::bulk;
use crate::error::{KernelError, Result};
use crate::evaluate::{moments_to_jet, Jet, CHUNK};
use crate::field::Field;

/// Nodes an axis that act on a point.
pub const WIDTH: usize = 6;
/// Values of the largest window.
const VOLUME: usize = WIDTH * WIDTH * WIDTH;
const PLANE: usize = WIDTH * WIDTH;

/// Weights of six nodes for the value and its derivatives along one axis.
type Weights = [[f64; WIDTH]; 3];

/// The field on node values, asked point by point.
pub struct Interpolant<'a, const D: usize> {
    blocks: &'a Blocks<D>,
    /// One over the distance of neighbouring nodes.
    inverse: [f64; D],
    /// First node of the window, which stays for the next point.
    start: [usize; D],
    /// With room for what the last row writes too much.
    window: [f64; VOLUME + WIDTH],
    /// Blocks that are not stored: outside and inside.
    constants: [Vec<f64>; 2],
}

/// Refuse spacings that are no lengths.
pub fn check_spacing<const D: usize>(spacing: &[f64; D]) -> Result<()> {
    if spacing.iter().all(|&h| h.is_finite() && h > 0.0) {
        return Ok(());
    }
    Err(KernelError::Invalid(format!(
        "spacing: found {spacing:?}, accepted are positive lengths"
    )))
}

impl<'a, const D: usize> Interpolant<'a, D> {
    /// `spacing` sets the unit of lengths: gradients and, for `jet`, points are in it.
    pub fn new(blocks: &'a Blocks<D>, spacing: &[f64; D]) -> Self {
        Self {
            blocks,
            inverse: spacing.map(|h| 1.0 / h),
            start: [usize::MAX; D],
            window: [0.0; VOLUME + WIDTH],
            constants: [blocks.far(), -blocks.far()].map(|v| vec![v; Blocks::<D>::VOLUME]),
        }
    }

    /// Value and derivatives up to `ORDER` at index coordinates; `Jet::OUTSIDE` outside of the grid. Values are clipped at
    /// the magnitude of what is not stored.
    #[inline(always)]
    pub fn at<const ORDER: usize>(&mut self, index: &[f64; D]) -> Jet<D> {
        let shape = self.blocks.shape();
        let mut weights = [[[0.0; WIDTH]; 3]; D];
        let mut start = [0; D];
        for a in 0..D {
            if !(index[a] >= 0.0 && index[a] <= (shape[a] - 1) as f64) {
                return Jet::OUTSIDE;
            }
            start[a] = weigh::<ORDER>(index[a], shape[a], self.inverse[a], &mut weights[a]);
        }
        if start != self.start {
            self.gather(&start);
            self.start = start;
        }
        let mut jet = contract::<D, ORDER>(&self.window, &weights);
        let far = self.blocks.far();
        jet.value = jet.value.clamp(-far, far);
        jet
    }

    /// Copy the window that starts at a node; it touches two blocks an axis at most.
    #[inline(always)]
    fn gather(&mut self, start: &[usize; D]) {
        let first = start.map(|s| s / SIDE);
        // Nodes of the window in the first block along each axis.
        let split: [usize; D] = std::array::from_fn(|a| (SIDE - start[a] % SIDE).min(WIDTH));
        let values = self.blocks.values();
        let mut sources: [&[f64]; 8] = [&self.constants[0]; 8];
        for (corner, source) in sources.iter_mut().enumerate().take(1 << D) {
            let upper: [usize; D] = std::array::from_fn(|a| corner >> (D - 1 - a) & 1);
            if (0..D).all(|a| upper[a] == 0 || split[a] < WIDTH) {
                let place = std::array::from_fn(|a| (first[a] + upper[a]) as i64);
                *source = match self.blocks.block(place) {
                    Neighbor::Slot(slot) => &values[slot as usize * Blocks::<D>::VOLUME..],
                    // Narrow grids end within a block, whose further nodes repeat the last: no border is met here.
                    Neighbor::Outside | Neighbor::Border => &self.constants[0],
                    Neighbor::Inside => &self.constants[1],
                };
            }
        }
        let (r, c) = (D - 2, D - 1);
        let (local, cut) = (start[c] % SIDE, split[c]);
        let planes = if D == 3 { WIDTH } else { 1 };
        for i in 0..planes {
            let (mut half, mut plane) = (0, 0);
            if D == 3 {
                half = 4 * usize::from(i >= split[0]);
                plane = (start[0] + i) % SIDE * SIDE;
            }
            for (upper, range) in [(0, 0..split[r]), (1, split[r]..WIDTH)] {
                let [low, high] = [sources[half + 2 * upper], sources[half + 2 * upper + 1]];
                for j in range {
                    // Whole rows of six from both blocks: copies of a fixed length are cheap. What the second one writes too
                    // much, the next row writes over.
                    let row = (plane + (start[r] + j) % SIDE) * SIDE;
                    let at = (i * WIDTH + j) * WIDTH;
                    self.window[at..at + WIDTH].copy_from_slice(&six(low, row + local));
                    if cut < WIDTH {
                        self.window[at + cut..at + cut + WIDTH].copy_from_slice(&six(high, row));
                    }
                }
            }
        }
    }
}

/// Six values from an offset on; what lies beyond the last block is of no account.
#[inline(always)]
fn six(values: &[f64], offset: usize) -> [f64; WIDTH] {
    let from = &values[offset..];
    from.first_chunk()
        .copied()
        .unwrap_or_else(|| std::array::from_fn(|k| from.get(k).copied().unwrap_or(0.0)))
}

impl<const D: usize> Field<D> for Interpolant<'_, D> {
    /// At a place, in units of the spacing, measured from the first node; clamped to the grid.
    #[inline(always)]
    fn jet(&mut self, x: &[f64; D]) -> Jet<D> {
        let shape = self.blocks.shape();
        self.at::<1>(&std::array::from_fn(|a| {
            (x[a] * self.inverse[a]).clamp(0.0, (shape[a] - 1) as f64)
        }))
    }
}

/// Weights of the six nodes from the returned one on; `n` nodes along the axis.
#[inline(always)]
fn weigh<const ORDER: usize>(x: f64, n: usize, inverse: f64, out: &mut Weights) -> usize {
    let cell = (x as usize).min(n - 2);
    let t = x - cell as f64;
    let s = 1.0 - t;
    let sixth = 1.0 / 6.0;
    let spline = [
        [
            s * s * s * sixth,
            (3.0 * t * t * (t - 2.0) + 4.0) * sixth,
            (3.0 * s * s * (s - 2.0) + 4.0) * sixth,
            t * t * t * sixth,
        ],
        [
            -0.5 * s * s,
            t * (1.5 * t - 2.0),
            -s * (1.5 * s - 2.0),
            0.5 * t * t,
        ],
        [s, 3.0 * t - 2.0, 3.0 * s - 2.0, t],
    ];
    let mut scale = 1.0;
    for (order, b) in spline.iter().enumerate().take(ORDER + 1) {
        let at = |k: usize| if (1..5).contains(&k) { b[k - 1] } else { 0.0 };
        for k in 0..WIDTH {
            let below = if k > 0 { at(k - 1) } else { 0.0 };
            out[order][k] = scale * sixth * (8.0 * at(k) - below - at(k + 1));
        }
        scale *= inverse;
    }
    if cell >= 2 && cell + 4 <= n {
        return cell - 2;
    }
    fold::<ORDER>(cell, n, out)
}

/// Give the weights of nodes beyond the grid to those that the values there follow from, f(-k) = (1 + k) f(0) - k f(1).
#[cold]
fn fold<const ORDER: usize>(cell: usize, n: usize, out: &mut Weights) -> usize {
    let start = (cell as isize - 2).clamp(0, n.saturating_sub(WIDTH) as isize);
    let last = n as isize - 1;
    for weights in out.iter_mut().take(ORDER + 1) {
        let mut folded = [0.0; WIDTH];
        for (k, &w) in weights.iter().enumerate() {
            let node = cell as isize - 2 + k as isize;
            let mut add = |to: isize, w: f64| folded[(to - start) as usize] += w;
            if node < 0 {
                add(0, w * (1 - node) as f64);
                add(1, w * node as f64);
            } else if node > last {
                add(last, w * (1 + node - last) as f64);
                add(last - 1, w * (last - node) as f64);
            } else {
                add(node, w);
            }
        }
        *weights = folded;
    }
    start as usize
}

/// Sums of the window's values with the products of the axes' weights: along the first axis first, whose lanes are long.
#[inline(always)]
fn contract<const D: usize, const ORDER: usize>(window: &[f64], weights: &[Weights; D]) -> Jet<D> {
    let mut planes = [[0.0; PLANE]; 3];
    if D == 3 {
        for (i, plane) in window[..VOLUME].chunks_exact(PLANE).enumerate() {
            for p in 0..=ORDER {
                let w = weights[0][p][i];
                for (sum, v) in planes[p].iter_mut().zip(plane) {
                    *sum += w * v;
                }
            }
        }
    } else {
        planes[0].copy_from_slice(&window[..PLANE]);
    }
    let depth = if D == 3 { ORDER } else { 0 };
    let mut moments = [[[0.0; 3]; 3]; 3];
    for p in 0..=depth {
        for q in 0..=ORDER - p {
            let mut line = [0.0; WIDTH];
            for (j, row) in planes[p].chunks_exact(WIDTH).enumerate() {
                let w = weights[D - 2][q][j];
                for (sum, v) in line.iter_mut().zip(row) {
                    *sum += w * v;
                }
            }
            for r in 0..=ORDER - p - q {
                let sum = (0..WIDTH).map(|k| weights[D - 1][r][k] * line[k]).sum();
                if D == 3 {
                    moments[p][q][r] = sum;
                } else {
                    moments[q][r][0] = sum;
                }
            }
        }
    }
    moments_to_jet::<D, ORDER>(&moments)
}

/// The field at many points in index coordinates, derivatives up to `order` (0, 1 or 2) in the unit of `spacing`.
pub fn evaluate<const D: usize>(
    blocks: &Blocks<D>,
    spacing: &[f64; D],
    points: &[[f64; D]],
    order: usize,
) -> Result<bulk::Field<D>> {
    check_spacing(spacing)?;
    let count = points.len();
    let mut field = bulk::Field {
        values: vec![0.0; count],
        gradients: vec![[0.0; D]; if order >= 1 { count } else { 0 }],
        hessians: vec![[[0.0; D]; D]; if order >= 2 { count } else { 0 }],
    };
    // As many chunks as points, whether they are asked for derivatives or not.
    let mut gradients: Vec<&mut [[f64; D]]> = field.gradients.chunks_mut(CHUNK).collect();
    let mut hessians: Vec<&mut [[[f64; D]; D]]> = field.hessians.chunks_mut(CHUNK).collect();
    let chunks = count.div_ceil(CHUNK);
    gradients.resize_with(chunks, Default::default);
    hessians.resize_with(chunks, Default::default);
    field
        .values
        .par_chunks_mut(CHUNK)
        .zip(gradients)
        .zip(hessians)
        .zip(points.par_chunks(CHUNK))
        .for_each(|(((values, gradients), hessians), points)| {
            let mut own = Interpolant::new(blocks, spacing);
            match order {
                0 => values_at::<D>(&mut own, points, values),
                1 => slopes_at::<D>(&mut own, points, values, gradients),
                _ => jets_at::<D>(&mut own, points, values, gradients, hessians),
            }
        });
    Ok(field)
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn values_at<const D: usize>(own: &mut Interpolant<'_, D>, points: &[[f64; D]], values: &mut [f64]) {
    for (x, value) in points.iter().zip(values) {
        *value = own.at::<0>(x).value;
    }
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn slopes_at<const D: usize>(
    own: &mut Interpolant<'_, D>,
    points: &[[f64; D]],
    values: &mut [f64],
    gradients: &mut [[f64; D]],
) {
    for ((x, value), gradient) in points.iter().zip(values).zip(gradients) {
        let jet = own.at::<1>(x);
        (*value, *gradient) = (jet.value, jet.gradient);
    }
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn jets_at<const D: usize>(
    own: &mut Interpolant<'_, D>,
    points: &[[f64; D]],
    values: &mut [f64],
    gradients: &mut [[f64; D]],
    hessians: &mut [[[f64; D]; D]],
) {
    let out = values.iter_mut().zip(gradients).zip(hessians);
    for (x, ((value, gradient), hessian)) in points.iter().zip(out) {
        let jet = own.at::<2>(x);
        (*value, *gradient, *hessian) = (jet.value, jet.gradient, jet.hessian);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cubic(x: [f64; 3]) -> Jet<3> {
        let [x, y, z] = x;
        let mut jet = Jet::ZERO;
        jet.value = x * x * y - 0.3 * z * z * z + x * y * z - 2.0 * y + 0.7;
        jet.gradient = [2.0 * x * y + y * z, x * x + x * z - 2.0, -0.9 * z * z + x * y];
        jet.hessian = [[2.0 * y, 2.0 * x + z, y], [2.0 * x + z, 0.0, x], [y, x, -1.8 * z]];
        jet
    }

    /// Away from the border, across blocks, with an anisotropic spacing.
    #[test]
    fn cubics_are_reproduced() {
        let (shape, spacing) = ([12, 20, 11], [0.5, 0.25, 0.4]);
        let mut dense = Vec::new();
        for i in 0..shape[0] {
            for j in 0..shape[1] {
                for k in 0..shape[2] {
                    let node = [i, j, k];
                    dense.push(cubic(std::array::from_fn(|a| node[a] as f64 * spacing[a])).value);
                }
            }
        }
        let blocks = Blocks::from_dense(shape, &dense, f64::INFINITY).unwrap();
        let step = [0.618_034, 0.754_878, 0.569_840];
        let points: Vec<[f64; 3]> = (0..400)
            .map(|p| std::array::from_fn(|a| 2.0 + (shape[a] - 5) as f64 * (f64::from(p) * step[a]).fract()))
            .collect();
        let field = evaluate(&blocks, &spacing, &points, 2).unwrap();
        for (p, x) in points.iter().enumerate() {
            let exact = cubic(std::array::from_fn(|a| x[a] * spacing[a]));
            assert!((field.values[p] - exact.value).abs() < 1e-12);
            for a in 0..3 {
                assert!((field.gradients[p][a] - exact.gradient[a]).abs() < 1e-11);
                for b in 0..3 {
                    assert!((field.hessians[p][a][b] - exact.hessian[a][b]).abs() < 1e-10);
                }
            }
        }
    }

    #[test]
    fn linear_functions_are_reproduced_up_to_the_border_of_the_narrowest_grids() {
        for shape in [[2, 3], [4, 9], [7, 2], [9, 17]] {
            let f = |i: f64, j: f64| 0.3 * i - 1.7 * j + 0.4;
            let dense: Vec<f64> = (0..shape[0] * shape[1])
                .map(|k| f((k / shape[1]) as f64, (k % shape[1]) as f64))
                .collect();
            let blocks = Blocks::from_dense(shape, &dense, f64::INFINITY).unwrap();
            let mut own = Interpolant::new(&blocks, &[1.0, 2.0]);
            for k in 0..100 {
                let x = [k % 10, k / 10];
                let x: [f64; 2] = std::array::from_fn(|a| f64::from(x[a]) / 9.0 * (shape[a] - 1) as f64);
                let jet = own.at::<2>(&x);
                assert!((jet.value - f(x[0], x[1])).abs() < 1e-12);
                assert!((jet.gradient[0] - 0.3).abs() < 1e-12 && (jet.gradient[1] + 0.85).abs() < 1e-12);
                assert!(jet.hessian.as_flattened().iter().all(|h| h.abs() < 1e-12));
            }
            assert!(own.at::<0>(&[-0.01, 0.0]).value.is_infinite());
            assert!(own.at::<0>(&[0.0, f64::NAN]).value.is_infinite());
        }
    }
}
