//! Scan conversion against distances in closed form, with nodes on faces, edges and corners.

use tspline_kernels::grid::scan::scan_convert;
use tspline_kernels::grid::{Blocks, Nodes};

type Mesh = (Vec<[f64; 3]>, Vec<[u32; 3]>);

/// A box, its faces split along diagonals that lines of nodes meet all along.
fn cuboid(low: [f64; 3], high: [f64; 3]) -> Mesh {
    let vertices = (0..8)
        .map(|k| std::array::from_fn(|q| if k >> q & 1 == 1 { high[q] } else { low[q] }))
        .collect();
    let quads: [[u32; 4]; 6] = [
        [0, 4, 6, 2],
        [1, 3, 7, 5],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 2, 3, 1],
        [4, 5, 7, 6],
    ];
    let faces = quads
        .iter()
        .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
        .collect();
    (vertices, faces)
}

fn together(a: Mesh, b: Mesh) -> Mesh {
    let shift = a.0.len() as u32;
    let faces = b.1.into_iter().map(|f| f.map(|v| v + shift));
    ([a.0, b.0].concat(), a.1.into_iter().chain(faces).collect())
}

/// Signed distance to a box.
fn exact(p: [f64; 3], low: [f64; 3], high: [f64; 3]) -> f64 {
    let q: [f64; 3] = std::array::from_fn(|a| (low[a] - p[a]).max(p[a] - high[a]));
    let outside = q.iter().map(|x| x.max(0.0).powi(2)).sum::<f64>().sqrt();
    outside + q.iter().copied().fold(f64::NEG_INFINITY, f64::max).min(0.0)
}

fn scanned(mesh: &Mesh, nodes: &Nodes, far: f64) -> Blocks<3> {
    scan_convert(&mesh.0, &mesh.1, nodes, far).unwrap()
}

#[test]
fn a_box_on_the_nodes() {
    let (low, high) = ([4.0, 5.0, 3.0], [20.0, 14.0, 17.0]);
    let nodes = Nodes::new([26, 21, 27], [0.0; 3], [1.0; 3]).unwrap();
    let mesh = cuboid(low, high);
    let dense = scanned(&mesh, &nodes, 2.5).to_dense();
    for (k, &v) in dense.iter().enumerate() {
        let node = [k / (21 * 27), k / 27 % 21, k % 27];
        let d = exact(nodes.point(node), low, high).clamp(-2.5, 2.5);
        // Nodes on the surface may have either sign of zero.
        assert!((v - d).abs() <= 1e-15, "{node:?}: {v} {d}");
    }
}

#[test]
fn an_oblong_grid_and_a_shape_beyond_it() {
    let (low, high) = ([-3.0, 0.3, 0.2], [1.1, 1.7, 9.0]);
    let nodes = Nodes::new([40, 30, 50], [-0.4, 0.1, -0.2], [0.06, 0.1, 0.04]).unwrap();
    let dense = scanned(&cuboid(low, high), &nodes, 0.25).to_dense();
    for (k, &v) in dense.iter().enumerate() {
        let node = [k / 1500, k / 50 % 30, k % 50];
        let d = exact(nodes.point(node), low, high).clamp(-0.25, 0.25);
        assert!((v - d).abs() <= 1e-15, "{node:?}: {v} {d}");
    }
}

#[test]
fn shapes_that_cut_one_another_are_their_union() {
    let a = ([2.0, 2.0, 2.0], [12.0, 12.0, 12.0]);
    let b = ([8.0, 8.0, 8.0], [19.0, 18.0, 17.0]);
    let nodes = Nodes::new([24; 3], [0.0; 3], [1.0; 3]).unwrap();
    let dense = scanned(&together(cuboid(a.0, a.1), cuboid(b.0, b.1)), &nodes, 2.0).to_dense();
    for (k, &v) in dense.iter().enumerate() {
        let p = nodes.point([k / 576, k / 24 % 24, k % 24]);
        let (da, db) = (exact(p, a.0, a.1), exact(p, b.0, b.1));
        if da.min(db) != 0.0 {
            assert_eq!(v < 0.0, da.min(db) < 0.0 && v != 0.0, "{p:?}: {v}");
        }
        assert!((v.abs() - da.abs().min(db.abs()).min(2.0)).abs() <= 1e-15);
    }
}

#[test]
fn a_needle_visits_few_blocks() {
    let nodes = Nodes::new([256; 3], [0.0; 3], [1.0; 3]).unwrap();
    let (from, to) = ([3.3, 4.1, 2.2], [251.0, 249.5, 252.7]);
    // A flat tetrahedron along the diagonal of the grid.
    let vertices = vec![from, to, [128.0, 126.0, 127.0], [127.0, 128.5, 127.0]];
    let faces = vec![[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]];
    let blocks = scanned(&(vertices, faces), &nodes, 2.0);
    assert!(blocks.len() < 300, "{}", blocks.len());
}

#[test]
fn bits_do_not_depend_on_threads() {
    let nodes = Nodes::new([70, 61, 54], [0.0; 3], [0.31, 0.29, 0.41]).unwrap();
    let mesh = together(
        cuboid([1.1, 1.7, 2.3], [9.2, 8.8, 11.1]),
        cuboid([6.1, 5.2, 4.4], [17.7, 14.4, 18.9]),
    );
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| scanned(&mesh, &nodes, 1.3))
    };
    let (one, four) = (with(1), with(4));
    assert_eq!(one.places(), four.places());
    assert_eq!(one.inside(), four.inside());
    let bits = |b: &Blocks<3>| b.values().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&one), bits(&four));
}

#[test]
fn what_cannot_be_meant_is_refused() {
    let (mut vertices, faces) = cuboid([1.0; 3], [2.0; 3]);
    let nodes = Nodes::new([9; 3], [0.0; 3], [1.0; 3]).unwrap();
    assert!(scan_convert(&vertices, &faces, &nodes, 0.5).is_err());
    assert!(scan_convert(&vertices, &[[0, 1, 8]], &nodes, 2.0).is_err());
    vertices[3][1] = f64::NAN;
    assert!(scan_convert(&vertices, &faces, &nodes, 2.0).is_err());
    assert!(Nodes::new([9; 3], [0.0; 3], [1.0, 0.0, 1.0]).is_err());
}
