//! Signed distances from the zero set of a field on a grid.

use rayon::prelude::*;
use rustc_hash::FxHashSet;

use super::blocks::{Blocks, SIDE};
use super::cells::live;
use super::foot::feet;
use super::interpolant::{check_spacing, evaluate};
use super::march::march;
use super::region::Region;
use crate::error::{KernelError, Result};
use crate::project::largest;
use crate::surface::MARGIN;

/// Foot points are taken up to this many spacings from the zero set, fast marching goes on from there.
const REACH: f64 = 4.0;

/// The signed distance within `band` of the zero set of the interpolant, +band or -band elsewhere; everywhere if the band is
/// infinite. Without a zero set all values are far off, on the side where they were: the band, or the grid's diagonal.
pub fn redistance<const D: usize>(source: &Blocks<D>, spacing: &[f64; D], band: f64) -> Result<Blocks<D>> {
    check_spacing(spacing)?;
    if band.is_nan() || band <= 0.0 {
        return Err(KernelError::Invalid(format!(
            "band: found {band}, accepted is a positive length"
        )));
    }
    let cells = live(source, MARGIN * largest(source.values()));
    let mut out = signs(source, band)?;
    let places = stored(source, spacing, band, &cells);
    out.store(&places);
    let mut region = Region::new(&out, spacing);
    enlist(&mut region, &cells);
    drop(cells);
    let indices: Vec<[f64; D]> = region
        .near
        .iter()
        .map(|&k| region.node(k).map(|x| x as f64))
        .collect();
    let values = evaluate(source, spacing, &indices, 0)?.values;
    let limit = band.min(REACH * region.widest);
    let found = feet(source, &region, &values, limit);
    let mut distances = vec![f64::INFINITY; region.len()];
    for (d, &k) in distances.iter_mut().zip(&found.of_node) {
        // Nodes a little further off came with others, but not all of them.
        *d = found
            .distances
            .get(k as usize)
            .copied()
            .filter(|&d| d <= limit)
            .unwrap_or(f64::INFINITY);
    }
    drop(found);
    if band > limit {
        march(&region, &mut distances, band);
    }
    let far = if band.is_finite() { band } else { diagonal(&region) };
    let number = std::mem::take(&mut region.number);
    let nodes: Vec<f64> = distances
        .par_iter()
        .enumerate()
        .with_min_len(4096)
        .map(|(k, &d)| {
            let node = region.node(k);
            let f = values
                .get(number[k] as usize)
                .copied()
                .unwrap_or_else(|| source.at(node.map(|x| x as i64)));
            d.min(far).copysign(if f < 0.0 { -1.0 } else { 1.0 })
        })
        .collect();
    out.values_mut().copy_from_slice(&nodes);
    out.pad();
    if band.is_finite() {
        let volume = Blocks::<D>::VOLUME;
        let kept: Vec<bool> = out
            .values()
            .par_chunks(volume)
            .map(|values| {
                let sign = values[0] < 0.0;
                values.iter().any(|v| v.abs() < band || (*v < 0.0) != sign)
            })
            .collect();
        out.keep(&kept);
    }
    Ok(out)
}

/// No block stored, each on the side where its first node is.
fn signs<const D: usize>(source: &Blocks<D>, band: f64) -> Result<Blocks<D>> {
    let mut out = Blocks::new(source.shape(), band)?;
    let counts = source.counts();
    for b in 0..counts.iter().product() {
        let place = place_of(b, &counts);
        if source.at(place.map(|p| i64::from(p) * SIDE as i64)) < 0.0 {
            out.set_inside(&place, true);
        }
    }
    Ok(out)
}

/// Blocks that may hold nodes within the band of the cells, in C order.
fn stored<const D: usize>(
    source: &Blocks<D>,
    spacing: &[f64; D],
    band: f64,
    cells: &[[u32; D]],
) -> Vec<[u32; D]> {
    let counts = source.counts();
    if band.is_infinite() {
        return (0..counts.iter().product())
            .map(|b| place_of(b, &counts))
            .collect();
    }
    let own: FxHashSet<[u32; D]> = cells.iter().map(|c| c.map(|x| x / SIDE as u32)).collect();
    let reach: [i64; D] =
        std::array::from_fn(|a| ((band / spacing[a] + 1.0) / SIDE as f64).ceil().min(1e6) as i64);
    let mut all = own;
    // A box of blocks is grown axis by axis.
    for a in 0..D {
        let from: Vec<[u32; D]> = all.iter().copied().collect();
        for place in from {
            let low = (i64::from(place[a]) - reach[a]).max(0);
            let high = (i64::from(place[a]) + reach[a]).min(counts[a] as i64 - 1);
            for at in low..=high {
                let mut near = place;
                near[a] = at as u32;
                all.insert(near);
            }
        }
    }
    let mut places: Vec<[u32; D]> = all.into_iter().collect();
    places.sort_unstable();
    places
}

/// Number the nodes of the cells.
fn enlist<const D: usize>(region: &mut Region<'_, D>, cells: &[[u32; D]]) {
    let mut marks = vec![false; region.len()];
    for cell in cells {
        for corner in 0..1_usize << D {
            let node = std::array::from_fn(|a| cell[a] as usize + (corner >> a & 1));
            if let Some(k) = region.find(node) {
                marks[k] = true;
            }
        }
    }
    region.number = vec![u32::MAX; region.len()];
    region.near = (0..marks.len()).filter(|&k| marks[k]).collect();
    for (number, &k) in region.near.iter().enumerate() {
        region.number[k] = number as u32;
    }
}

fn diagonal<const D: usize>(region: &Region<'_, D>) -> f64 {
    region.high.iter().map(|h| h * h).sum::<f64>().sqrt()
}

fn place_of<const D: usize>(mut b: usize, counts: &[usize; D]) -> [u32; D] {
    let mut place = [0; D];
    for a in (0..D).rev() {
        place[a] = (b % counts[a]) as u32;
        b /= counts[a];
    }
    place
}
