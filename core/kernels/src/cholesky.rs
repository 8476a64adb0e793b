//! Multifrontal sparse Cholesky factorisation over a nested dissection.

use crate::dense::{backward, forward, partial_cholesky};
use crate::dissection::{Dissection, Front};
use crate::error::{KernelError, Result};
use crate::pattern::Pattern;

/// A subtree with fewer entries than this is not worth a task of its own.
const TASK: usize = 40_000;

/// A = L L^T in the order of the dissection. The panel of a front is column-major, `columns` wide and
/// `columns + rows` high.
#[derive(Debug, Clone)]
pub struct Factor {
    panels: Vec<f64>,
}

struct Job<'a> {
    pattern: &'a Pattern,
    dissection: &'a Dissection,
    lower: &'a [f64],
}

impl Factor {
    /// Factorise the matrix whose lower triangle (in the pattern's order) is given.
    pub fn new(pattern: &Pattern, dissection: &Dissection, lower: &[f64]) -> Result<Self> {
        let mut panels = vec![0.0; dissection.panel_size];
        let job = Job {
            pattern,
            dissection,
            lower,
        };
        let roots = roots(dissection);
        let mut rest = panels.as_mut_slice();
        for root in roots {
            let size = job.subtree_size(root);
            let (mine, other) = rest.split_at_mut(size);
            job.eliminate(root, mine)?;
            rest = other;
        }
        Ok(Self { panels })
    }

    /// Solve A x = b; `b` and `x` in the matrix's own order.
    pub fn solve(&self, dissection: &Dissection, b: &[f64], x: &mut [f64]) {
        let mut y: Vec<f64> = dissection.order.iter().map(|&i| b[i as usize]).collect();
        let mut local = Vec::new();
        let collect = |local: &mut Vec<f64>, front: &Front, y: &[f64]| {
            local.clear();
            local.extend_from_slice(&y[front.first..front.first + front.columns]);
            local.extend(front.rows.iter().map(|&r| y[r as usize]));
        };
        for front in &dissection.fronts {
            collect(&mut local, front, &y);
            forward(self.panel(front), front.columns, &mut local);
            y[front.first..front.first + front.columns].copy_from_slice(&local[..front.columns]);
            for (&r, value) in front.rows.iter().zip(&local[front.columns..]) {
                y[r as usize] = *value;
            }
        }
        for front in dissection.fronts.iter().rev() {
            collect(&mut local, front, &y);
            backward(self.panel(front), front.columns, &mut local);
            y[front.first..front.first + front.columns].copy_from_slice(&local[..front.columns]);
        }
        for (&i, value) in dissection.order.iter().zip(y) {
            x[i as usize] = value;
        }
    }

    fn panel(&self, front: &Front) -> &[f64] {
        &self.panels[front.panel..front.panel + front.columns * (front.columns + front.rows.len())]
    }
}

fn roots(dissection: &Dissection) -> Vec<usize> {
    let mut is_child = vec![false; dissection.fronts.len()];
    for front in &dissection.fronts {
        for &child in &front.children {
            is_child[child] = true;
        }
    }
    (0..is_child.len()).filter(|&k| !is_child[k]).collect()
}

impl Job<'_> {
    fn subtree_size(&self, front: usize) -> usize {
        let f = &self.dissection.fronts[front];
        f.panel + f.columns * (f.columns + f.rows.len()) - self.dissection.fronts[f.subtree].panel
    }

    /// Eliminate the subtree under `front` into its panels; returns the update matrix (column-major, lower triangle)
    /// that its parent takes over.
    fn eliminate(&self, front: usize, panels: &mut [f64]) -> Result<Vec<f64>> {
        let f = &self.dissection.fronts[front];
        let (c, r) = (f.columns, f.rows.len());
        let m = c + r;
        let mut matrix = vec![0.0; m * m];
        let (below, own) = panels.split_at_mut(panels.len() - c * m);
        let updates = match f.children.as_slice() {
            [a, b] => {
                let (left, right) = below.split_at_mut(self.subtree_size(*a));
                if left.len().min(right.len()) > TASK {
                    let (u, v) = rayon::join(|| self.eliminate(*a, left), || self.eliminate(*b, right));
                    vec![(*a, u?), (*b, v?)]
                } else {
                    vec![(*a, self.eliminate(*a, left)?), (*b, self.eliminate(*b, right)?)]
                }
            }
            [a] => vec![(*a, self.eliminate(*a, below)?)],
            _ => Vec::new(),
        };
        self.scatter(front, &mut matrix);
        for (child, update) in updates {
            extend_add(
                &self.dissection.fronts[child].rows,
                &update,
                f.first,
                c,
                &f.rows,
                &mut matrix,
            );
        }
        partial_cholesky(&mut matrix, m, c).map_err(|k| {
            KernelError::NotSolved(format!(
                "the normal equations are not positive definite (unknown {})",
                self.dissection.order[f.first + k]
            ))
        })?;
        own.copy_from_slice(&matrix[..c * m]);
        let mut update = vec![0.0; r * r];
        for j in 0..r {
            update[j * r + j..(j + 1) * r].copy_from_slice(&matrix[(c + j) * m + c + j..(c + j + 1) * m]);
        }
        Ok(update)
    }

    /// Entries of the matrix in the columns of a front.
    fn scatter(&self, front: usize, matrix: &mut [f64]) {
        let f = &self.dissection.fronts[front];
        let m = f.columns + f.rows.len();
        for k in 0..f.columns {
            let i = self.dissection.order[f.first + k] as usize;
            for (at, &j) in (self.pattern.row_start[i]..).zip(self.pattern.row(i)) {
                let place = self.dissection.place[j as usize] as usize;
                if place < f.first + k {
                    continue;
                }
                let row = row_in(place, f.first, f.columns, &f.rows);
                matrix[k * m + row] += self.lower[self.pattern.lower_of[at] as usize];
            }
        }
    }
}

/// Row of the unknown at `place` in a front's matrix.
fn row_in(place: usize, first: usize, columns: usize, rows: &[u32]) -> usize {
    if place < first + columns {
        place - first
    } else {
        columns + rows.partition_point(|&r| (r as usize) < place)
    }
}

fn extend_add(from: &[u32], update: &[f64], first: usize, columns: usize, rows: &[u32], matrix: &mut [f64]) {
    let m = columns + rows.len();
    let n = from.len();
    let to: Vec<usize> = from
        .iter()
        .map(|&r| row_in(r as usize, first, columns, rows))
        .collect();
    for j in 0..n {
        let column = &mut matrix[to[j] * m..(to[j] + 1) * m];
        for i in j..n {
            column[to[i]] += update[j * n + i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TMesh;
    use crate::refine::from_points;

    #[test]
    fn factor_solves_a_diagonally_dominant_matrix() {
        let mesh: TMesh<2> = from_points(&[[0.31, 0.62], [0.8, 0.2]], &[6, 5], 2, 2, 100_000).unwrap();
        let n = mesh.num_functions();
        let pattern = Pattern::new(mesh.elements(), n).unwrap();
        let dissection = Dissection::new(mesh.anchors(), &pattern);
        let mut lower = vec![0.0; pattern.lower_start[n]];
        for i in 0..n {
            for (k, &j) in pattern
                .row(i)
                .iter()
                .take_while(|&&j| j as usize <= i)
                .enumerate()
            {
                let j = j as usize;
                lower[pattern.lower_start[i] + k] = if i == j {
                    90.0
                } else {
                    ((i * 31 + j * 17) as f64).sin()
                };
            }
        }
        let mut full = vec![0.0; pattern.columns.len()];
        pattern.mirror(&lower, &mut full);
        let x: Vec<f64> = (0..n).map(|i| (i as f64 * 0.7).cos()).collect();
        let b: Vec<f64> = (0..n)
            .map(|i| {
                let range = pattern.row_start[i]..pattern.row_start[i + 1];
                full[range]
                    .iter()
                    .zip(pattern.row(i))
                    .map(|(v, &j)| v * x[j as usize])
                    .sum()
            })
            .collect();
        let factor = Factor::new(&pattern, &dissection, &lower).unwrap();
        let mut y = vec![0.0; n];
        factor.solve(&dissection, &b, &mut y);
        let error = x.iter().zip(&y).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(error < 1e-12, "{error}");
    }

    #[test]
    fn indefinite_matrix_is_reported() {
        let mesh = TMesh::<2>::uniform(2).unwrap();
        let n = mesh.num_functions();
        let pattern = Pattern::new(mesh.elements(), n).unwrap();
        let dissection = Dissection::new(mesh.anchors(), &pattern);
        let lower = vec![0.0; pattern.lower_start[n]];
        assert!(Factor::new(&pattern, &dissection, &lower).is_err());
    }
}
