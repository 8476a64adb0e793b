//! Closed triangle meshes on the zero set of a field in space, by dual marching cubes on a sparse lattice.

mod faces;
mod hull;
pub(crate) mod lattice;
mod live;
mod local;
mod relax;
mod table;
mod vertices;

use crate::bulk::evaluate;
use crate::error::{KernelError, Result};
use crate::field::Field;
use crate::mesh::TMesh;
use crate::tree::{MAX_LEVEL, SIDE};
use lattice::Lattice;
use live::{Live, Signs};
use local::Local;

/// A closed 2-manifold: every edge has two triangles, every vertex one fan of them. Triangles are counter-clockwise seen
/// from outside (f > 0).
#[derive(Debug, Clone, Default)]
pub struct Surface {
    /// In the box.
    pub vertices: Vec<[f64; 3]>,
    /// Unit normals, outward.
    pub normals: Vec<[f64; 3]>,
    pub triangles: Vec<[i64; 3]>,
}

/// Signs of sums are trusted beyond this share of the largest coefficient.
pub(crate) const MARGIN: f64 = 1e-12;
/// Values below this share of it count as zero, and zero counts as outside.
pub(crate) const ZERO: f64 = 1e-14;

/// The zero set, triangulated on a lattice `2^subdivision` times as fine as the smallest leaves that it visits. The
/// outside of the box counts as f > 0, so that shapes cut by the box are closed along it.
pub fn surface(mesh: &TMesh<3>, c: &[f64], subdivision: i8) -> Result<Surface> {
    mesh.check_coefficients(c)?;
    let scale = c.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let signs = Signs::new(mesh, c, MARGIN * scale);
    let Some(finest) = signs.finest_level() else {
        return Ok(Surface::default());
    };
    let level = i16::from(finest) + i16::from(subdivision);
    if level > i16::from(MAX_LEVEL) {
        return Err(KernelError::TooLarge(format!(
            "subdivision: found {subdivision} of cells at level {finest}, together at most {MAX_LEVEL}"
        )));
    }
    let level = level.max(0) as u8;
    let live = signs.cubes(level)?;
    let mut lattice = Lattice::new([1 << level; 3], [1.0 / f64::from(1 << level); 3]);
    give_values(&mut lattice, &signs, &live, level)?;
    drop(live);
    triangulate(lattice, ZERO * scale, || Local::new(mesh, c))
}

/// The surface between the inside (values below `-zero`) and outside nodes of a lattice, its vertices on the zero set of
/// the field that made the values.
pub(crate) fn triangulate<F: Field<3>>(
    mut lattice: Lattice,
    zero: f64,
    field: impl Fn() -> F + Sync + Send,
) -> Result<Surface> {
    let count = lattice.classify(zero);
    let quads = faces::quads(&lattice)?;
    let (mut vertices, mut normals) = vertices::vertices(&field, &lattice);
    debug_assert_eq!(vertices.len(), count);
    let side = lattice.side;
    let high = std::array::from_fn(|a| f64::from(lattice.n[a]) * side[a]);
    drop(lattice);
    relax::relax(&field, high, side, &quads, &mut vertices, &mut normals);
    let triangles = faces::triangles(&quads, &vertices, &normals);
    Ok(Surface {
        vertices,
        normals,
        triangles,
    })
}

/// Every node of a live cube gets one value: the first that comes with a cube, the leaf's sign where it has one, else the
/// field itself. (Numerator and field have one sign, and values are but a start for the vertices.)
fn give_values(lattice: &mut Lattice, signs: &Signs<'_>, live: &Live, level: u8) -> Result<()> {
    let mut last = usize::MAX;
    for &(at, value) in &live.leaves {
        lattice.set(at, value, &mut last);
        lattice.enliven(at, &mut last);
    }
    let mut lasts = [usize::MAX; 8];
    for cube in &live.cubes {
        lattice.enliven(cube.at, &mut lasts[0]);
        for (k, &value) in cube.values.iter().enumerate() {
            if !value.is_nan() {
                let node = std::array::from_fn(|a| cube.at[a] + (k >> a & 1) as i32);
                lattice.set(node, value, &mut lasts[k]);
            }
        }
    }
    let shift = MAX_LEVEL - level;
    let tree = signs.mesh.tree();
    let mut nodes = Vec::new();
    for node in lattice.missing() {
        let leaf = tree.leaf_at(node.map(|x| ((x as u32) << shift).min(SIDE - 1)));
        match signs.of_leaf[leaf] {
            0 => nodes.push(node),
            sign => lattice.put(node, f64::from(sign) * f64::INFINITY, &mut last),
        }
    }
    let scale = lattice.side[0];
    let places: Vec<[f64; 3]> = nodes.iter().map(|p| p.map(|x| f64::from(x) * scale)).collect();
    let values = evaluate(signs.mesh, signs.c, &places, 0)?.values;
    for (&node, value) in nodes.iter().zip(values) {
        lattice.put(node, value, &mut last);
    }
    Ok(())
}

#[cfg(test)]
mod tests;
