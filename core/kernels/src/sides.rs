//! Inside and outside of a cloud without normals, from its Delaunay tetrahedra.
//!
//! A tetrahedron's circumscribed ball holds no sample, so that it lies on one side of the surface. Unknowns are a side x
//! of every tetrahedron and a sign s of every sample's normal line, infinity is outside (+1). Three kinds of evidence,
//! each an edge of a graph with a weight and a sign:
//!
//! - a sample sees the balls that touch it along its normal line on either side: s and x agree for balls on the
//!   normal's side and oppose each other on the other one; the better aligned, the heavier (power 4 of the cosine);
//! - balls across a common facet that intersect deeply are on one side: exp(4 cos - 4) of the angle at which they meet;
//! - the half-spaces beyond the hull's facets are outside.
//!
//! The minimiser of sum w (x_a - sign x_b)^2 with infinity at 1 is a sparse linear system. Where all evidence agrees it
//! is +-1 exactly; contradictions (noise, creases, holes) shrink |x| but rarely change its sign. That two balls of one
//! sample lie on opposite sides is the idea of Kolluri, Shewchuk and O'Brien, "Spectral surface reconstruction from noisy
//! point clouds" (2004); the boundary condition at infinity takes the place of their eigenvector.

use rayon::prelude::*;

use crate::conjugate::conjugate_gradients;
use crate::error::{KernelError, Result};

/// Nodes of a chunk: sums over chunks are added in order.
const CHUNK: usize = 4096;

/// What is known of each sample.
#[derive(Debug, Clone, Copy)]
pub struct Samples<'a> {
    pub points: &'a [[f64; 3]],
    pub normals: &'a [[f64; 3]],
    /// Trust in the normal line, 0 to 1.
    pub trust: &'a [f64],
    /// Radius below which a ball tells less: about the distance of neighbouring samples.
    pub reach: &'a [f64],
}

/// Sides of tetrahedra and signs of samples' normals, both in [-1, 1], and the tetrahedra's balls.
#[derive(Debug, Clone)]
pub struct Sides {
    pub cells: Vec<f64>,
    pub samples: Vec<f64>,
    pub centers: Vec<[f64; 3]>,
    pub radii: Vec<f64>,
    pub iterations: usize,
}

/// The evidence of one tetrahedron.
struct Evidence {
    /// Signed weights towards its four samples.
    samples: [f64; 4],
    /// Weights towards the neighbours across the facets (opposite to each corner); beyond the hull: towards infinity.
    facets: [f64; 4],
}

/// Solve for the sides; `cells` and `neighbours` as Qhull gives them (-1: beyond the hull).
pub fn sides(given: Samples<'_>, cells: &[[i32; 4]], neighbours: &[[i32; 4]]) -> Result<Sides> {
    let count = given.points.len();
    let bad = |list: &[[i32; 4]], low: i32, high: usize| {
        list.iter().flatten().any(|&v| v < low || v >= high as i32)
    };
    if cells.len() != neighbours.len() || bad(cells, 0, count) || bad(neighbours, -1, cells.len()) {
        return Err(KernelError::Invalid(
            "cells: numbers that are no sample's or no cell's".into(),
        ));
    }
    let balls: Vec<([f64; 3], f64)> = cells
        .par_iter()
        .map(|cell| ball(cell.map(|v| given.points[v as usize])))
        .collect();
    let evidence: Vec<Evidence> = (0..cells.len())
        .into_par_iter()
        .map(|t| evidence(&given, &balls, t, &cells[t], &neighbours[t]))
        .collect();
    let graph = Graph::new(&given, &evidence, cells, neighbours);
    let (x, iterations) = graph.solve(1e-3, 1000);
    let (centers, radii) = balls.into_iter().unzip();
    Ok(Sides {
        samples: x[cells.len()..].to_vec(),
        cells: x[..cells.len()].to_vec(),
        centers,
        radii,
        iterations,
    })
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|q| a[q] - b[q])
}

fn inner(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|q| {
        let (r, s) = ((q + 1) % 3, (q + 2) % 3);
        a[r] * b[s] - a[s] * b[r]
    })
}

/// Circumscribed ball of four points; a flat tetrahedron's is so large that it acts as a half-space.
fn ball(p: [[f64; 3]; 4]) -> ([f64; 3], f64) {
    let [a, b, c] = [minus(p[1], p[0]), minus(p[2], p[0]), minus(p[3], p[0])];
    let (bc, ca, ab) = (cross(b, c), cross(c, a), cross(a, b));
    let volume = 2.0 * inner(a, bc);
    let (a2, b2, c2) = (inner(a, a), inner(b, b), inner(c, c));
    let up: [f64; 3] = std::array::from_fn(|q| a2 * bc[q] + b2 * ca[q] + c2 * ab[q]);
    let least = 1e-14 * inner(up, up).sqrt();
    let volume = if volume.abs() > least {
        volume
    } else {
        least.copysign(volume)
    };
    let center = if volume == 0.0 {
        [0.0; 3]
    } else {
        up.map(|v| v / volume)
    };
    let radius = inner(center, center).sqrt();
    (std::array::from_fn(|q| p[0][q] + center[q]), radius)
}

fn evidence(
    given: &Samples<'_>,
    balls: &[([f64; 3], f64)],
    t: usize,
    cell: &[i32; 4],
    beside: &[i32; 4],
) -> Evidence {
    let (center, radius) = balls[t];
    let samples = cell.map(|v| {
        let v = v as usize;
        let cosine = inner(minus(center, given.points[v]), given.normals[v]) / radius.max(1e-300);
        let size = (radius / given.reach[v]).min(1.0);
        (cosine * cosine).powi(2) * given.trust[v] * size * size * cosine.signum()
    });
    let facets = std::array::from_fn(|f| {
        let cosine = if beside[f] >= 0 {
            let (other, r) = balls[beside[f] as usize];
            let apart = minus(center, other);
            (radius * radius + r * r - inner(apart, apart)) / (2.0 * radius * r)
        } else {
            let (normal, corner) = hull_facet(given.points, cell, f);
            inner(minus(center, corner), normal) / radius
        };
        (4.0 * cosine.clamp(-1.0, 1.0) - 4.0).exp()
    });
    Evidence { samples, facets }
}

/// Outward unit normal of the facet opposite to corner f, and one of its corners.
fn hull_facet(points: &[[f64; 3]], cell: &[i32; 4], f: usize) -> ([f64; 3], [f64; 3]) {
    let at = |q: usize| points[cell[(f + q) % 4] as usize];
    let normal = cross(minus(at(2), at(1)), minus(at(3), at(1)));
    let length = inner(normal, normal).sqrt().max(1e-300);
    let outward = if inner(normal, minus(at(0), at(1))) > 0.0 {
        -1.0
    } else {
        1.0
    };
    (normal.map(|v| outward * v / length), at(1))
}

/// The signed graph: cells first, then samples.
struct Graph<'a> {
    evidence: &'a [Evidence],
    cells: &'a [[i32; 4]],
    neighbours: &'a [[i32; 4]],
    /// For every sample its places (4 cell + corner), `start[s]..start[s + 1]`.
    start: Vec<u32>,
    places: Vec<u32>,
    diagonal: Vec<f64>,
    right: Vec<f64>,
}

impl<'a> Graph<'a> {
    fn new(
        given: &Samples<'_>,
        evidence: &'a [Evidence],
        cells: &'a [[i32; 4]],
        neighbours: &'a [[i32; 4]],
    ) -> Self {
        let (m, count) = (cells.len(), given.points.len());
        let mut start = vec![0u32; count + 1];
        for &v in cells.iter().flatten() {
            start[v as usize + 1] += 1;
        }
        for s in 0..count {
            start[s + 1] += start[s];
        }
        let mut places = vec![0u32; 4 * m];
        let mut next = start.clone();
        for (place, &v) in cells.iter().flatten().enumerate() {
            places[next[v as usize] as usize] = place as u32;
            next[v as usize] += 1;
        }
        let mut diagonal = vec![0.0; m + count];
        let mut right = vec![0.0; m + count];
        for (t, e) in evidence.iter().enumerate() {
            for q in 0..4 {
                diagonal[t] += e.facets[q] + e.samples[q].abs();
                diagonal[m + cells[t][q] as usize] += e.samples[q].abs();
                if neighbours[t][q] >= 0 {
                    continue;
                }
                right[t] += e.facets[q];
                // The half-space beyond a facet of the hull is a ball that touches the facet's samples.
                let (normal, _) = hull_facet(given.points, &cells[t], q);
                for f in 1..4 {
                    let v = cells[t][(q + f) % 4] as usize;
                    let cosine = inner(normal, given.normals[v]);
                    let weight = (cosine * cosine).powi(2) * given.trust[v];
                    diagonal[m + v] += weight;
                    right[m + v] += weight * cosine.signum();
                }
            }
        }
        let largest = diagonal.iter().copied().fold(0.0, f64::max);
        for d in &mut diagonal {
            // Keeps what no evidence reaches solvable, at 0.
            *d += 1e-9 * largest;
        }
        Self {
            evidence,
            cells,
            neighbours,
            start,
            places,
            diagonal,
            right,
        }
    }

    /// y = A x.
    fn multiply(&self, x: &[f64], y: &mut [f64]) {
        let m = self.cells.len();
        let (by_cell, by_sample) = y.split_at_mut(m);
        by_cell
            .par_iter_mut()
            .enumerate()
            .with_min_len(CHUNK)
            .for_each(|(t, y)| {
                let e = &self.evidence[t];
                let mut sum = self.diagonal[t] * x[t];
                for q in 0..4 {
                    sum -= e.samples[q] * x[m + self.cells[t][q] as usize];
                    if self.neighbours[t][q] >= 0 {
                        sum -= e.facets[q] * x[self.neighbours[t][q] as usize];
                    }
                }
                *y = sum;
            });
        by_sample
            .par_iter_mut()
            .enumerate()
            .with_min_len(CHUNK / 4)
            .for_each(|(s, y)| {
                let mut sum = self.diagonal[m + s] * x[m + s];
                for &place in &self.places[self.start[s] as usize..self.start[s + 1] as usize] {
                    let (t, q) = (place as usize / 4, place as usize % 4);
                    sum -= self.evidence[t].samples[q] * x[t];
                }
                *y = sum;
            });
    }

    /// The sides, by conjugate gradients with the diagonal.
    fn solve(&self, tolerance: f64, most: usize) -> (Vec<f64>, usize) {
        let inverse: Vec<f64> = self
            .diagonal
            .iter()
            .map(|&d| if d > 0.0 { 1.0 / d } else { 0.0 })
            .collect();
        let (x, iterations, _) = conjugate_gradients(
            |p, q| self.multiply(p, q),
            self.right.clone(),
            &inverse,
            tolerance,
            most,
        );
        (x, iterations)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNERS: [[f64; 3]; 4] = [
        [1.0, 1.0, 1.0],
        [1.0, -1.0, -1.0],
        [-1.0, 1.0, -1.0],
        [-1.0, -1.0, 1.0],
    ];

    #[test]
    fn a_ball_touches_its_four_points() {
        let p = [
            [0.1, 0.2, 0.3],
            [1.0, 0.0, 0.4],
            [0.2, 0.9, -0.1],
            [0.3, 0.1, 1.2],
        ];
        let (center, radius) = ball(p);
        for q in p {
            let d = minus(q, center);
            assert!((inner(d, d).sqrt() - radius).abs() < 1e-14);
        }
    }

    #[test]
    fn a_flat_tetrahedron_has_a_huge_ball() {
        let (center, radius) = ball([[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.9, 0.8, 0.0]]);
        assert!(center.iter().all(|v| v.is_finite()) && radius > 1e10 && radius.is_finite());
    }

    #[test]
    fn a_tetrahedron_between_its_normals_is_inside() {
        let turned = |signs: [f64; 4]| {
            let normals: Vec<[f64; 3]> = (0..4)
                .map(|q| CORNERS[q].map(|v| signs[q] * v / 3f64.sqrt()))
                .collect();
            let given = Samples {
                points: &CORNERS,
                normals: &normals,
                trust: &[1.0; 4],
                reach: &[1.0; 4],
            };
            sides(given, &[[0, 1, 2, 3]], &[[-1; 4]]).unwrap()
        };
        for signs in [[1.0; 4], [-1.0; 4], [1.0, -1.0, -1.0, 1.0]] {
            let found = turned(signs);
            assert!(found.cells[0] < 0.0);
            assert!((0..4).all(|q| found.samples[q] * signs[q] > 0.0));
            assert!((found.radii[0] - 3f64.sqrt()).abs() < 1e-14);
        }
    }
}
