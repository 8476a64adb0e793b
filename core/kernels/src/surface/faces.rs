//! Triangles of the dual surface: a quad around every crossed edge of the lattice, cut along its better diagonal.

use rayon::prelude::*;

use super::lattice::{bit_of, bits, place, Lattice};
use super::table::table;
use crate::error::{KernelError, Result};

/// Bricks in one unit of parallel work.
const CHUNK: usize = 64;

type Vector = [f64; 3];

/// The quads' corners, counter-clockwise seen from outside.
pub fn quads(lattice: &Lattice) -> Result<Vec<[u32; 4]>> {
    let parts: Vec<Result<Vec<[u32; 4]>>> = (0..lattice.bricks.len())
        .collect::<Vec<_>>()
        .par_chunks(CHUNK)
        .map(|numbers| {
            let mut out = Vec::new();
            for &b in numbers {
                if lattice.bricks[b].active != 0 {
                    quads_of(lattice, b, &mut out)?;
                }
            }
            Ok(out)
        })
        .collect();
    let mut all = Vec::new();
    for part in parts {
        all.extend(part?);
    }
    Ok(all)
}

/// Quads of the edges that start at the lower corners of a brick's cubes.
fn quads_of(lattice: &Lattice, b: usize, out: &mut Vec<[u32; 4]>) -> Result<()> {
    let brick = &lattice.bricks[b];
    let around = lattice.around(b, -1);
    for k in bits(brick.active) {
        let case = brick.cases[k];
        let p = place(brick.corner, k);
        for a in 0..3 {
            let inside = case & 1 == 1;
            if (case >> (1 << a) & 1 == 1) == inside {
                continue;
            }
            let (b, c) = ((a + 1) % 3, (a + 2) % 3);
            let mut quad = [0; 4];
            // The four cubes around the edge, counter-clockwise seen from its upper end.
            for (corner, [back_b, back_c]) in quad.iter_mut().zip([[0, 0], [1, 0], [1, 1], [0, 1]]) {
                let mut q = p;
                q[b] -= back_b;
                q[c] -= back_c;
                let subset = (0..3).fold(0, |s, d| s | usize::from(q[d] < brick.corner[d]) << d);
                let edge = 4 * a + (back_b + 2 * back_c) as usize;
                *corner = around[subset]
                    .and_then(|other| vertex(lattice, other, bit_of(q), edge))
                    .ok_or_else(|| {
                        KernelError::NotSolved("the surface has a crack; please report this".into())
                    })?;
            }
            if !inside {
                quad.reverse();
            }
            out.push(quad);
        }
    }
    Ok(())
}

fn vertex(lattice: &Lattice, b: usize, k: usize, edge: usize) -> Option<u32> {
    let brick = &lattice.bricks[b];
    if brick.active >> k & 1 == 0 {
        return None;
    }
    let patches = table().patches(brick.cases[k], brick.turned >> k & 1 == 1);
    let of = patches.of_edge[edge];
    (of < patches.count).then(|| brick.first[k] + u32::from(of))
}

/// Two triangles a quad.
pub fn triangles(quads: &[[u32; 4]], points: &[Vector], normals: &[Vector]) -> Vec<[i64; 3]> {
    let mut out = vec![[0; 3]; 2 * quads.len()];
    out.par_chunks_mut(2)
        .zip(quads)
        .with_min_len(4096)
        .for_each(|(pair, quad)| {
            for (triangle, corners) in pair.iter_mut().zip(cut(quad, points, normals).0) {
                *triangle = corners.map(|k| i64::from(quad[k]));
            }
        });
    out
}

/// Cut a quad along the diagonal whose worse triangle is the better one: corners of both triangles, and the direction that
/// is outward there.
#[inline]
pub fn cut(quad: &[u32; 4], points: &[Vector], normals: &[Vector]) -> ([[usize; 3]; 2], Vector) {
    let corner = quad.map(|v| &points[v as usize]);
    let sum = quad.iter().fold([0.0; 3], |s, &v| add(&s, &normals[v as usize]));
    let length = dot(&sum, &sum).sqrt();
    let up = if length > 0.0 {
        sum.map(|x| x / length)
    } else {
        sum
    };
    let quality = |[i, j, k]: [usize; 3]| shape(corner[i], corner[j], corner[k], &up);
    let cuts = [[[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]];
    let [first, second] = cuts.map(|[s, t]| quality(s).min(quality(t)));
    (cuts[usize::from(second > first)], up)
}

/// Area over squared sides, times the cosine to the direction `up`: 1 for an equilateral triangle, negative if turned over.
#[inline]
pub fn shape(p: &Vector, q: &Vector, r: &Vector, up: &Vector) -> f64 {
    let (u, v, w) = (subtract(q, p), subtract(r, p), subtract(r, q));
    let normal = [
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    ];
    let squares = (dot(&u, &u) + dot(&v, &v) + dot(&w, &w)).max(f64::MIN_POSITIVE);
    2.0 * 3.0_f64.sqrt() * dot(&normal, up) / squares
}

fn add(p: &Vector, q: &Vector) -> Vector {
    [p[0] + q[0], p[1] + q[1], p[2] + q[2]]
}

fn subtract(p: &Vector, q: &Vector) -> Vector {
    [p[0] - q[0], p[1] - q[1], p[2] - q[2]]
}

fn dot(p: &Vector, q: &Vector) -> f64 {
    p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
}
