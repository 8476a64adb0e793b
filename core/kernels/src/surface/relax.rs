//! Better shapes: vertices of thin triangles move between their neighbours, along the zero set.
//!
//! A cube that the surface just touches has its vertex in a corner, close to those of the cubes beside it. Only such
//! vertices are moved, half a cube at most, so that most of the surface costs nothing here.

use rayon::prelude::*;

use super::faces::{cut, shape};
use crate::field::Field;

/// Rounds of moves.
const ROUNDS: usize = 3;
/// Triangles below this share of an equilateral one's shape are thin: the angles of those above exceed 17 degrees.
const THIN: f64 = 0.55;
/// Vertices in one unit of parallel work.
const CHUNK: usize = 256;
/// Newton steps after a move; it is undone where they do not arrive.
const STEPS: usize = 6;
/// Distance from the zero set, in units of the box, that counts as none.
const REACHED: f64 = 1e-14;

/// Move the vertices of thin triangles in the box up to `high`; `side` has the sides of a cube.
pub fn relax<F: Field<3>>(
    field: impl Fn() -> F + Sync,
    high: [f64; 3],
    side: [f64; 3],
    quads: &[[u32; 4]],
    points: &mut [[f64; 3]],
    normals: &mut [[f64; 3]],
) {
    let mut origin: Vec<(usize, [f64; 3])> = Vec::new();
    let mut worst = worst_shapes(quads, points, normals);
    for round in 0..ROUNDS {
        // What is on the box stays there: it closes the shape.
        let thin: Vec<usize> = (0..points.len())
            .filter(|&v| worst[v] < THIN && (0..3).all(|a| points[v][a] > 0.0 && points[v][a] < high[a]))
            .collect();
        if thin.is_empty() {
            return;
        }
        if round == 0 {
            origin = thin.iter().map(|&v| (v, points[v])).collect();
        }
        let middles = middles(&thin, quads, points);
        let places: &[[f64; 3]] = points;
        let directions: &[[f64; 3]] = normals;
        let moves: Vec<Option<[[f64; 3]; 2]>> = thin
            .par_chunks(CHUNK)
            .zip(middles.par_chunks(CHUNK))
            .flat_map_iter(|(thin, middles)| {
                let mut field = field();
                let moves: Vec<_> = thin
                    .iter()
                    .zip(middles)
                    .map(|(&v, middle)| {
                        let home = origin
                            .binary_search_by_key(&v, |o| o.0)
                            .map_or(places[v], |k| origin[k].1);
                        arrive(&mut field, middle, &home, &directions[v], [&high, &side])
                    })
                    .collect();
                moves
            })
            .collect();
        let mut before = Vec::with_capacity(thin.len());
        for (&v, new) in thin.iter().zip(moves) {
            before.push((v, points[v], normals[v]));
            if let Some([x, n]) = new {
                (points[v], normals[v]) = (x, n);
            }
        }
        let after = worst_shapes(quads, points, normals);
        for (v, x, n) in before {
            if after[v] <= worst[v] {
                (points[v], normals[v]) = (x, n);
            }
        }
        worst = worst_shapes(quads, points, normals);
    }
}

/// Shape of the worst triangle at each vertex, 1 for an equilateral one.
fn worst_shapes(quads: &[[u32; 4]], points: &[[f64; 3]], normals: &[[f64; 3]]) -> Vec<f64> {
    let shapes: Vec<[f64; 2]> = quads
        .par_iter()
        .with_min_len(4096)
        .map(|quad| {
            let (pair, up) = cut(quad, points, normals);
            pair.map(|t| {
                let [p, q, r] = t.map(|k| &points[quad[k] as usize]);
                shape(p, q, r, &up)
            })
        })
        .collect();
    let mut worst = vec![f64::INFINITY; points.len()];
    for (quad, shapes) in quads.iter().zip(shapes) {
        let least = shapes[0].min(shapes[1]);
        for &v in quad {
            worst[v as usize] = worst[v as usize].min(least);
        }
    }
    worst
}

/// The mean of each vertex's neighbours.
fn middles(thin: &[usize], quads: &[[u32; 4]], points: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let mut number = vec![u32::MAX; points.len()];
    for (k, &v) in thin.iter().enumerate() {
        number[v] = k as u32;
    }
    let mut sums = vec![([0.0; 3], 0.0); thin.len()];
    // Every edge is run along in both directions, so that each neighbour comes once.
    for quad in quads {
        for i in 0..4 {
            if let Some((sum, count)) = sums.get_mut(number[quad[i] as usize] as usize) {
                let x = &points[quad[(i + 1) % 4] as usize];
                for a in 0..3 {
                    sum[a] += x[a];
                }
                *count += 1.0;
            }
        }
    }
    sums.into_iter()
        .map(|(sum, count)| sum.map(|s| s / count))
        .collect()
}

/// The zero set near `start`, at most half a cube from `home` along each axis and with a normal like `normal`.
fn arrive(
    field: &mut impl Field<3>,
    start: &[f64; 3],
    home: &[f64; 3],
    normal: &[f64; 3],
    [high, side]: [&[f64; 3]; 2],
) -> Option<[[f64; 3]; 2]> {
    let clip = |x: [f64; 3]| -> [f64; 3] {
        std::array::from_fn(|a| x[a].clamp(home[a] - 0.5 * side[a], home[a] + 0.5 * side[a]))
    };
    let mut x = clip(*start);
    for _ in 0..STEPS {
        if (0..3).any(|a| x[a] <= 0.0 || x[a] >= high[a]) {
            return None;
        }
        let f = field.jet(&x);
        let g = f.gradient;
        let square = g[0] * g[0] + g[1] * g[1] + g[2] * g[2];
        if f.value.abs() <= REACHED * square.sqrt() {
            let n = g.map(|v| v / square.sqrt());
            let along = n[0] * normal[0] + n[1] * normal[1] + n[2] * normal[2];
            return (along > 0.7).then_some([x, n]);
        }
        let step = f.value / square;
        if !step.is_finite() {
            return None;
        }
        x = clip(std::array::from_fn(|a| x[a] - step * g[a]));
    }
    None
}
