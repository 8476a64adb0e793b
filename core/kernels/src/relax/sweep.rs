//! One step of the primal-dual method, row by row.

use multiversion::multiversion;
use rayon::prelude::*;

use super::grid::Grid;

/// What is minimised: sum edges |grad u| - evidence u.
#[derive(Clone, Copy)]
pub struct Energy<'a> {
    pub evidence: &'a [f32],
    pub edges: &'a [f32],
}

/// Where the method is. `dual` holds the components of a row one after the other: (rows, D, cols).
pub struct State {
    pub u: Vec<f32>,
    /// Foreseen u, 2 u~ - u.
    pub ahead: Vec<f32>,
    pub dual: Vec<f32>,
    /// Primal steps.
    pub tau: Vec<f32>,
}

/// Dual step, in units of the edges' weight.
pub struct Step {
    pub sigma: f32,
    /// 1: none, below 2: over-relaxation.
    pub relaxation: f32,
}

pub fn advance<const D: usize>(grid: &Grid<D>, energy: Energy, state: &mut State, step: &Step) {
    let (cols, chunk) = (grid.cols(), grid.chunk());
    let dual = &state.dual;
    state
        .u
        .par_chunks_mut(chunk * cols)
        .zip(state.ahead.par_chunks_mut(chunk * cols))
        .enumerate()
        .for_each(|(k, (u, ahead))| {
            primal_rows(
                grid,
                energy.evidence,
                dual,
                &state.tau,
                u,
                ahead,
                k * chunk,
                step.relaxation,
            );
        });
    let ahead = &state.ahead;
    state
        .dual
        .par_chunks_mut(chunk * D * cols)
        .enumerate()
        .for_each(|(k, dual)| dual_rows(grid, energy.edges, ahead, dual, k * chunk, step));
}

/// The dual that goes with a labelling: along its gradients, as long as it may be.
pub fn align<const D: usize>(grid: &Grid<D>, edges: &[f32], state: &mut State) {
    let (cols, chunk) = (grid.cols(), grid.chunk());
    let u = &state.u;
    // Any step that is long beside the spacing ends on the ball's surface.
    let step = Step {
        sigma: 1e6 / grid.inverse.iter().copied().fold(0.0, f32::max),
        relaxation: 1.0,
    };
    state
        .dual
        .par_chunks_mut(chunk * D * cols)
        .enumerate()
        .for_each(|(k, dual)| dual_rows(grid, edges, u, dual, k * chunk, &step));
}

/// out = div p of a row: minus the adjoint of forward differences. p is 0 on the border's far side.
#[inline(always)]
pub fn divergence<const D: usize>(grid: &Grid<D>, dual: &[f32], row: usize, out: &mut [f32]) {
    let n = grid.cols();
    let of = |row: usize, axis: usize| &dual[(row * D + axis) * n..][..n];
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
    evidence: &[f32],
    dual: &[f32],
    tau: &[f32],
    u: &mut [f32],
    ahead: &mut [f32],
    first: usize,
    relaxation: f32,
) {
    let n = grid.cols();
    for (k, (u, ahead)) in u.chunks_exact_mut(n).zip(ahead.chunks_exact_mut(n)).enumerate() {
        let row = first + k;
        divergence(grid, dual, row, ahead);
        let evidence = &evidence[row * n..][..n];
        let tau = &tau[row * n..][..n];
        for j in 0..n {
            let old = u[j];
            let new = (old + tau[j] * (ahead[j] + evidence[j])).max(0.0).min(1.0);
            ahead[j] = 2.0 * new - old;
            u[j] = old + relaxation * (new - old);
        }
    }
}

/// Forward differences of u at a row's pixel, of rows that are u itself beyond the border.
#[inline(always)]
pub fn after<'a, const D: usize>(grid: &Grid<D>, u: &'a [f32], row: usize) -> [&'a [f32]; D] {
    let n = grid.cols();
    std::array::from_fn(|axis| {
        let other = if axis + 1 < D {
            grid.after(row, axis).unwrap_or(row)
        } else {
            row
        };
        &u[other * n..][..n]
    })
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn dual_rows<const D: usize>(
    grid: &Grid<D>,
    edges: &[f32],
    ahead: &[f32],
    dual: &mut [f32],
    first: usize,
    step: &Step,
) {
    let n = grid.cols();
    for (k, dual) in dual.chunks_exact_mut(D * n).enumerate() {
        let row = first + k;
        let edges = &edges[row * n..][..n];
        let own = &ahead[row * n..][..n];
        let after = after(grid, ahead, row);
        if D == 2 {
            let (a, b) = dual.split_at_mut(n);
            dual_plane(grid, edges, own, after[0], [a, b], step);
        } else {
            let (a, rest) = dual.split_at_mut(n);
            let (b, c) = rest.split_at_mut(n);
            dual_space(grid, edges, own, [after[0], after[1]], [a, b, c], step);
        }
    }
}

/// p + sigma grad u, put back on the ball |p| <= edges, with over-relaxation.
#[inline(always)]
fn dual_plane<const D: usize>(
    grid: &Grid<D>,
    edges: &[f32],
    own: &[f32],
    below: &[f32],
    [a, b]: [&mut [f32]; 2],
    step: &Step,
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
    own: &[f32],
    [behind, below]: [&[f32]; 2],
    [a, b, c]: [&mut [f32]; 3],
    step: &Step,
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
        (0..n).map(|k| (k as f32 * 0.618_034 * (1.0 + k as f32)).fract() - 0.5).collect()
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
            divergence(&grid, &dual, row, &mut out);
            let own = &u[row * n..][..n];
            let next = after(&grid, &u, row);
            for j in 0..n {
                right -= f64::from(own[j] * out[j]);
                for axis in 0..D {
                    let there = if axis + 1 < D { next[axis][j] } else { own[(j + 1).min(n - 1)] };
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
