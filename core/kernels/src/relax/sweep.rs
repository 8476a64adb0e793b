//! One step of the primal-dual method, row by row.

use multiversion::multiversion;
use rayon::prelude::*;

use super::grid::Grid;
use super::simplex;

/// What is minimised: the sum over classes of edges |grad u| - evidence u.
#[derive(Clone, Copy)]
pub struct Energy<'a> {
    /// (classes, rows, cols)
    pub evidence: &'a [f32],
    pub edges: &'a [f32],
}

/// Where the method is. One class: u in [0, 1]; several: shares that add up to 1.
pub struct State {
    pub classes: usize,
    /// (rows, classes, cols)
    pub u: Vec<f32>,
    /// Foreseen u, 2 u~ - u.
    pub ahead: Vec<f32>,
    /// (rows, classes, D, cols)
    pub dual: Vec<f32>,
    /// Primal steps (rows, cols).
    pub tau: Vec<f32>,
}

/// Dual step, in units of the edges' weight, and relaxation: 1 is none, below 2 goes beyond the step.
#[derive(Clone, Copy)]
pub struct Step {
    pub sigma: f32,
    pub relaxation: f32,
}

pub fn advance<const D: usize>(grid: &Grid<D>, energy: Energy, state: &mut State, step: Step) {
    let (chunk, size) = (grid.chunk(), grid.cols() * state.classes);
    let (dual, tau, classes) = (&state.dual, &state.tau, state.classes);
    state
        .u
        .par_chunks_mut(chunk * size)
        .zip(state.ahead.par_chunks_mut(chunk * size))
        .enumerate()
        .for_each(|(k, (u, ahead))| {
            primal_rows(
                grid,
                classes,
                energy.evidence,
                dual,
                tau,
                u,
                ahead,
                k * chunk,
                step.relaxation,
            );
        });
    let ahead = &state.ahead;
    state
        .dual
        .par_chunks_mut(chunk * D * size)
        .enumerate()
        .for_each(|(k, dual)| dual_rows(grid, classes, energy.edges, ahead, dual, k * chunk, step));
}

/// The dual that goes with a labelling: along its gradients, as long as it may be.
pub fn align<const D: usize>(grid: &Grid<D>, edges: &[f32], state: &mut State) {
    let (chunk, size) = (grid.chunk(), grid.cols() * state.classes);
    let (u, classes) = (&state.u, state.classes);
    // Any step that is long beside the spacing ends on the ball's surface.
    let step = Step {
        sigma: 1e6 / grid.inverse.iter().copied().fold(0.0, f32::max),
        relaxation: 1.0,
    };
    state
        .dual
        .par_chunks_mut(chunk * D * size)
        .enumerate()
        .for_each(|(k, dual)| dual_rows(grid, classes, edges, u, dual, k * chunk, step));
}

/// out = div p of a class in a row: minus the adjoint of forward differences. p is 0 on the border's far side.
#[inline(always)]
pub fn divergence<const D: usize>(
    grid: &Grid<D>,
    classes: usize,
    dual: &[f32],
    row: usize,
    class: usize,
    out: &mut [f32],
) {
    let n = grid.cols();
    let of = |row: usize, axis: usize| &dual[((row * classes + class) * D + axis) * n..][..n];
    let along = of(row, D - 1);
    let scale = grid.inverse[D - 1];
    out[0] = scale * along[0];
    for (o, pair) in out[1..].iter_mut().zip(along.windows(2)) {
        *o = scale * (pair[1] - pair[0]);
    }
    for axis in 0..D - 1 {
        let scale = grid.inverse[axis];
        let own = of(row, axis);
        match grid.before(row, axis) {
            Some(other) => {
                for ((o, &a), &b) in out.iter_mut().zip(own).zip(of(other, axis)) {
                    *o += scale * (a - b);
                }
            }
            None => {
                for (o, &a) in out.iter_mut().zip(own) {
                    *o += scale * a;
                }
            }
        }
    }
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn primal_rows<const D: usize>(
    grid: &Grid<D>,
    classes: usize,
    evidence: &[f32],
    dual: &[f32],
    tau: &[f32],
    u: &mut [f32],
    ahead: &mut [f32],
    first: usize,
    relaxation: f32,
) {
    let (n, size) = (grid.cols(), grid.cols() * classes);
    for (k, (u, ahead)) in u
        .chunks_exact_mut(size)
        .zip(ahead.chunks_exact_mut(size))
        .enumerate()
    {
        let row = first + k;
        let tau = &tau[row * n..][..n];
        for class in 0..classes {
            let ahead = &mut ahead[class * n..][..n];
            divergence(grid, classes, dual, row, class, ahead);
            let evidence = &evidence[class * grid.len() + row * n..][..n];
            let u = &u[class * n..][..n];
            for j in 0..n {
                ahead[j] = u[j] + tau[j] * (ahead[j] + evidence[j]);
            }
        }
        if classes == 1 {
            for a in ahead.iter_mut() {
                *a = a.clamp(0.0, 1.0);
            }
        } else {
            simplex::project(ahead, classes);
        }
        for (u, a) in u.iter_mut().zip(ahead.iter_mut()) {
            let change = *a - *u;
            *a += change;
            *u += relaxation * change;
        }
    }
}

/// Rows of the next pixels along each axis, of which the last axis' is the row itself; beyond the border also.
#[inline(always)]
pub fn after<'a, const D: usize>(
    grid: &Grid<D>,
    classes: usize,
    u: &'a [f32],
    row: usize,
    class: usize,
) -> [&'a [f32]; D] {
    let n = grid.cols();
    std::array::from_fn(|axis| {
        let next = (axis + 1 < D)
            .then(|| grid.after(row, axis))
            .flatten()
            .unwrap_or(row);
        &u[(next * classes + class) * n..][..n]
    })
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn dual_rows<const D: usize>(
    grid: &Grid<D>,
    classes: usize,
    edges: &[f32],
    ahead: &[f32],
    dual: &mut [f32],
    first: usize,
    step: Step,
) {
    let n = grid.cols();
    for (k, dual) in dual.chunks_exact_mut(D * n).enumerate() {
        let (row, class) = (first + k / classes, k % classes);
        let edges = &edges[row * n..][..n];
        let after = after(grid, classes, ahead, row, class);
        let (a, rest) = dual.split_at_mut(n);
        if D == 2 {
            dual_plane(grid, edges, [after[0], after[1]], [a, rest], step);
        } else {
            let (b, c) = rest.split_at_mut(n);
            dual_space(grid, edges, [after[0], after[1], after[2]], [a, b, c], step);
        }
    }
}

/// p + sigma grad u, put back on the ball |p| <= edges, with over-relaxation.
#[inline(always)]
fn dual_plane<const D: usize>(
    grid: &Grid<D>,
    edges: &[f32],
    [below, own]: [&[f32]; 2],
    [a, b]: [&mut [f32]; 2],
    step: Step,
) {
    let n = own.len();
    let (edges, below, a, b) = (&edges[..n], &below[..n], &mut a[..n], &mut b[..n]);
    let mut pixel = |j: usize, right: f32| {
        let s = step.sigma * edges[j];
        let u = own[j];
        let p = a[j] + s * grid.inverse[0] * (below[j] - u);
        let q = b[j] + s * grid.inverse[1] * (right - u);
        let shrink = shrink(edges[j], p * p + q * q);
        a[j] += step.relaxation * (p * shrink - a[j]);
        b[j] += step.relaxation * (q * shrink - b[j]);
    };
    for j in 0..n - 1 {
        pixel(j, own[j + 1]);
    }
    pixel(n - 1, own[n - 1]);
}

#[inline(always)]
fn dual_space<const D: usize>(
    grid: &Grid<D>,
    edges: &[f32],
    [behind, below, own]: [&[f32]; 3],
    [a, b, c]: [&mut [f32]; 3],
    step: Step,
) {
    let n = own.len();
    let (edges, behind, below) = (&edges[..n], &behind[..n], &below[..n]);
    let (a, b, c) = (&mut a[..n], &mut b[..n], &mut c[..n]);
    let mut pixel = |j: usize, right: f32| {
        let s = step.sigma * edges[j];
        let u = own[j];
        let p = a[j] + s * grid.inverse[0] * (behind[j] - u);
        let q = b[j] + s * grid.inverse[1] * (below[j] - u);
        let r = c[j] + s * grid.inverse[2] * (right - u);
        let shrink = shrink(edges[j], p * p + q * q + r * r);
        a[j] += step.relaxation * (p * shrink - a[j]);
        b[j] += step.relaxation * (q * shrink - b[j]);
        c[j] += step.relaxation * (r * shrink - c[j]);
    };
    for j in 0..n - 1 {
        pixel(j, own[j + 1]);
    }
    pixel(n - 1, own[n - 1]);
}

/// What brings a vector of this squared length into the ball.
#[inline(always)]
pub fn shrink(radius: f32, square: f32) -> f32 {
    radius / radius.max(square.sqrt()).max(f32::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(n: usize) -> Vec<f32> {
        (0..n)
            .map(|k| (k as f32 * 0.618_034 * (1.0 + k as f32)).fract() - 0.5)
            .collect()
    }

    /// <grad u, p> = -<u, div p>.
    fn adjoint<const D: usize>(shape: [usize; D]) {
        let grid = Grid {
            shape,
            inverse: std::array::from_fn(|a| 1.0 / (1.0 + a as f32)),
        };
        let n = grid.cols();
        let u = noise(grid.len());
        let mut dual = noise(grid.len() * D);
        let (mut left, mut right) = (0.0, 0.0);
        let mut out = vec![0.0; n];
        for row in 0..grid.len() / n {
            // Beyond the border there is no difference, hence no dual.
            for axis in 0..D - 1 {
                if grid.after(row, axis).is_none() {
                    dual[(row * D + axis) * n..][..n].fill(0.0);
                }
            }
            dual[(row * D + D) * n - 1] = 0.0;
        }
        for row in 0..grid.len() / n {
            divergence(&grid, 1, &dual, row, 0, &mut out);
            let own = &u[row * n..][..n];
            let next = after(&grid, 1, &u, row, 0);
            for j in 0..n {
                right -= f64::from(own[j] * out[j]);
                for axis in 0..D {
                    let there = if axis + 1 < D {
                        next[axis][j]
                    } else {
                        own[(j + 1).min(n - 1)]
                    };
                    let p = dual[(row * D + axis) * n + j];
                    left += f64::from(grid.inverse[axis] * (there - own[j]) * p);
                }
            }
        }
        assert!((left - right).abs() < 1e-5, "{left} {right}");
    }

    #[test]
    fn divergence_is_minus_the_gradients_adjoint() {
        adjoint([7, 5]);
        adjoint([1, 9]);
        adjoint([4, 3, 6]);
        adjoint([3, 1, 2]);
    }

    #[test]
    fn vectors_shrink_onto_the_ball_and_no_further() {
        let long = shrink(0.5, 3.0 * 3.0 + 4.0 * 4.0);
        assert!((long * 5.0 - 0.5).abs() < 1e-6);
        assert!((shrink(2.0, 1.0) - 1.0).abs() < f32::EPSILON);
        assert!(shrink(0.0, 0.0).abs() < f32::EPSILON);
    }
}
