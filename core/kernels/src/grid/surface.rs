//! Closed triangle meshes on the zero set of a grid in space.

use super::blocks::Blocks;
use super::cells::live;
use super::interpolant::{check_spacing, evaluate, Interpolant};
use crate::error::{KernelError, Result};
use crate::project::largest;
use crate::surface::lattice::Lattice;
use crate::surface::{triangulate, Surface, MARGIN, ZERO};

/// Cubes beyond this number are refused: the surface alone would take gigabytes.
const MAX_CUBES: usize = 1 << 24;

/// The zero set on a lattice `2^subdivision` times as fine as the grid, up to rounding to whole cubes. Places are measured
/// from the first node in the unit of `spacing`. The outside of the grid counts as f > 0.
pub fn surface(blocks: &Blocks<3>, spacing: &[f64; 3], subdivision: i8) -> Result<(Surface, [f64; 3])> {
    check_spacing(spacing)?;
    let cells = blocks.shape().map(|n| n as u64 - 1);
    let fine = f64::from(subdivision).exp2();
    let n = cells.map(|c| (c as f64 * fine).round().max(1.0));
    if n.iter().any(|&n| n > f64::from(1 << 28)) {
        return Err(KernelError::TooLarge(format!(
            "subdivision: found {subdivision}, more than 2^28 cubes an axis"
        )));
    }
    let n = n.map(|n| n as u64);
    let scale = largest(blocks.values());
    let live = live(blocks, MARGIN * scale);
    let a_cell: u64 = (0..3).map(|a| n[a].div_ceil(cells[a])).product();
    if live.len() as u64 * a_cell > MAX_CUBES as u64 {
        return Err(KernelError::TooLarge(format!(
            "the zero set passes more than {MAX_CUBES} cubes: take a larger tolerance"
        )));
    }
    let side: [f64; 3] = std::array::from_fn(|a| cells[a] as f64 * spacing[a] / n[a] as f64);
    let mut lattice = Lattice::new(n.map(|n| n as i32), side);
    let mut last = usize::MAX;
    for cell in &live {
        // The cubes that meet the cell: on coarse lattices several cells share one.
        let low: [u64; 3] = std::array::from_fn(|a| u64::from(cell[a]) * n[a] / cells[a]);
        let high: [u64; 3] = std::array::from_fn(|a| ((u64::from(cell[a]) + 1) * n[a]).div_ceil(cells[a]));
        for z in low[2]..high[2] {
            for y in low[1]..high[1] {
                for x in low[0]..high[0] {
                    lattice.enliven([x as i32, y as i32, z as i32], &mut last);
                }
            }
        }
    }
    drop(live);
    give_values(&mut lattice, blocks, spacing)?;
    let high = std::array::from_fn(|a| f64::from(lattice.n[a]) * side[a]);
    let surface = triangulate(lattice, ZERO * scale, || Interpolant::new(blocks, spacing))?;
    Ok((surface, high))
}

/// The interpolant at all nodes of live cubes.
fn give_values(lattice: &mut Lattice, blocks: &Blocks<3>, spacing: &[f64; 3]) -> Result<()> {
    let nodes = lattice.missing();
    let shape = blocks.shape();
    let n = lattice.n;
    let places: Vec<[f64; 3]> = nodes
        .iter()
        .map(|p| std::array::from_fn(|a| f64::from(p[a]) * (shape[a] - 1) as f64 / f64::from(n[a])))
        .collect();
    let values = evaluate(blocks, spacing, &places, 0)?.values;
    let mut last = usize::MAX;
    for (&node, value) in nodes.iter().zip(values) {
        lattice.put(node, value, &mut last);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise in blocks of which many are not stored, uniform blocks of random signs among them.
    #[test]
    fn any_blocks_make_a_closed_surface() {
        let mut state = 20_051_u64;
        let mut noise = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        for round in 0..12_u32 {
            let shape = [11, 25, 18];
            let counts = [2_usize, 4, 3];
            let mut places = Vec::new();
            for k in 0..24 {
                if noise() < 0.1 * f64::from(round) {
                    places.push([k / 12, k / 3 % 4, k % 3].map(|p: u32| p));
                }
            }
            let values: Vec<f64> = (0..places.len() * 512).map(|_| noise() - 0.4).collect();
            let inside: Vec<bool> = (0..counts.iter().product::<usize>())
                .map(|_| noise() < 0.3)
                .collect();
            let blocks = Blocks::from_parts(shape, 0.5, &places, &values, &inside).unwrap();
            for subdivision in -1..=1 {
                let (s, high) = surface(&blocks, &[0.03, 0.02, 0.04], subdivision).unwrap();
                let mut ways = rustc_hash::FxHashMap::<(i64, i64), i32>::default();
                for t in &s.triangles {
                    for i in 0..3 {
                        *ways.entry((t[i], t[(i + 1) % 3])).or_default() += 1;
                    }
                }
                assert!(ways
                    .iter()
                    .all(|(&(p, q), &k)| k == 1 && ways.contains_key(&(q, p))));
                assert!(s
                    .vertices
                    .iter()
                    .all(|x| (0..3).all(|a| x[a] >= 0.0 && x[a] <= high[a])));
            }
        }
    }
}
