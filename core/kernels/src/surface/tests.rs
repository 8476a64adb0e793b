use super::lattice::{bits, Lattice};
use super::table::table;
use super::*;
use crate::refine::from_points;
use rustc_hash::FxHashMap;

/// Euler number of a surface of quads, after a check that it is a closed 2-manifold: every edge has two quads that run
/// along it in opposite directions, every vertex one ring of them.
fn euler(quads: &[[u32; 4]], count: usize) -> i64 {
    let mut ways: FxHashMap<(u32, u32), usize> = FxHashMap::default();
    let mut fans: Vec<Vec<(u32, u32)>> = vec![Vec::new(); count];
    for (k, quad) in quads.iter().enumerate() {
        for i in 0..4 {
            let (p, q, before) = (quad[i], quad[(i + 1) % 4], quad[(i + 3) % 4]);
            assert!(
                ways.insert((p, q), k).is_none(),
                "an edge has two quads in one direction"
            );
            fans[p as usize].push((q, before));
        }
    }
    for &(p, q) in ways.keys() {
        assert!(ways.contains_key(&(q, p)), "an edge has one quad");
    }
    for fan in &fans {
        let next: FxHashMap<u32, u32> = fan.iter().copied().collect();
        let first = fan[0].0;
        let (mut at, mut steps) = (next[&first], 1);
        while at != first {
            at = next[&at];
            steps += 1;
        }
        assert_eq!(steps, fan.len(), "a vertex has two fans");
    }
    count as i64 - ways.len() as i64 / 2 + quads.len() as i64
}

/// A lattice with all cubes live and the given values at the nodes.
fn full(n: i32, mut value: impl FnMut([i32; 3]) -> f64) -> Lattice {
    let mut lattice = Lattice::new([n; 3], [1.0 / f64::from(n); 3]);
    let mut last = usize::MAX;
    for z in 0..=n {
        for y in 0..=n {
            for x in 0..=n {
                lattice.set([x, y, z], value([x, y, z]), &mut last);
                if x < n && y < n && z < n {
                    lattice.enliven([x, y, z], &mut last);
                }
            }
        }
    }
    assert!(lattice.missing().is_empty());
    lattice
}

fn noise(state: &mut u64) -> f64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    (*state >> 11) as f64 / (1_u64 << 53) as f64
}

#[test]
fn random_signs_always_make_a_closed_manifold() {
    let mut state = 20_050_601;
    for round in 0..4000 {
        let n = 2 + round % 5;
        let share = 0.05 + 0.9 * noise(&mut state);
        let mut lattice = full(n, |_| noise(&mut state) - share);
        let count = lattice.classify(0.0);
        euler(&faces::quads(&lattice).unwrap(), count);
    }
}

/// Edges of a surface of quads that more than two quads share.
fn pinches(quads: &[[u32; 4]]) -> usize {
    let mut ways: FxHashMap<(u32, u32), usize> = FxHashMap::default();
    for quad in quads {
        for i in 0..4 {
            *ways.entry((quad[i], quad[(i + 1) % 4])).or_default() += 1;
        }
    }
    ways.values().filter(|&&k| k > 1).count()
}

#[test]
fn without_turned_cubes_the_surface_would_be_pinched() {
    let mut state = 7;
    let mut lattice = full(12, |_| noise(&mut state) - 0.5);
    lattice.classify(0.0);
    assert_eq!(pinches(&faces::quads(&lattice).unwrap()), 0);
    let mut count = 0;
    for brick in &mut lattice.bricks {
        brick.turned = 0;
        for k in bits(brick.active) {
            brick.first[k] = count;
            count += u32::from(table().patches(brick.cases[k], false).count);
        }
    }
    assert!(pinches(&faces::quads(&lattice).unwrap()) > 0);
}

#[test]
fn a_checkerboard_is_as_many_boxes() {
    let mut lattice = full(6, |p| f64::from((p[0] + p[1] + p[2]) % 2) - 0.5);
    let count = lattice.classify(0.0);
    let inside = 7_i64.pow(3) / 2 + 1;
    assert_eq!(euler(&faces::quads(&lattice).unwrap(), count), 2 * inside);
}

/// Coefficients at the Greville abscissae.
fn greville(mesh: &TMesh<3>, f: impl Fn([f64; 3]) -> f64) -> Vec<f64> {
    let middle = |k: &[u32; 5]| f64::from(k[1] + k[2] + k[3]) / 3.0 / f64::from(SIDE);
    mesh.knots()
        .iter()
        .map(|k| f([middle(&k[0]), middle(&k[1]), middle(&k[2])]))
        .collect()
}

fn closed(surface: &Surface) -> i64 {
    let mut ways: FxHashMap<(i64, i64), usize> = FxHashMap::default();
    for t in &surface.triangles {
        for i in 0..3 {
            *ways.entry((t[i], t[(i + 1) % 3])).or_default() += 1;
        }
    }
    assert!(ways
        .iter()
        .all(|(&(p, q), &k)| k == 1 && ways.contains_key(&(q, p))));
    surface.vertices.len() as i64 - surface.triangles.len() as i64 / 2
}

#[test]
fn a_ball_on_uniform_and_graded_meshes_at_all_subdivisions() {
    let ball = |x: [f64; 3]| x.map(|v| (v - 0.5).powi(2)).iter().sum::<f64>().sqrt() - 0.3;
    let graded = from_points(&[[0.5, 0.5, 0.8], [0.2, 0.5, 0.5]], &[6, 5], 1, 2, 100_000).unwrap();
    for mesh in [TMesh::uniform(3).unwrap(), TMesh::uniform(4).unwrap(), graded] {
        let c = greville(&mesh, ball);
        for subdivision in -1..=2 {
            let surface = surface(&mesh, &c, subdivision).unwrap();
            assert_eq!(closed(&surface), 2, "{subdivision}");
            let field = evaluate(&mesh, &c, &surface.vertices, 0).unwrap();
            assert!(field.values.iter().all(|v| v.abs() < 1e-12));
        }
    }
}

#[test]
fn a_half_space_is_closed_along_the_box() {
    let mesh = TMesh::uniform(2).unwrap();
    let c = greville(&mesh, |x| x[0] + 0.3 * x[1] - 0.61);
    for subdivision in 0..3 {
        let s = surface(&mesh, &c, subdivision).unwrap();
        assert_eq!(closed(&s), 2);
        let volume: f64 = s
            .triangles
            .iter()
            .map(|t| {
                let [p, q, r] = t.map(|k| s.vertices[k as usize]);
                (p[0] * (q[1] * r[2] - q[2] * r[1])
                    + p[1] * (q[2] * r[0] - q[0] * r[2])
                    + p[2] * (q[0] * r[1] - q[1] * r[0]))
                    / 6.0
            })
            .sum();
        assert!((volume - 0.46).abs() < 1e-12, "{volume}");
    }
}

#[test]
fn the_whole_box_and_nothing() {
    let mesh = TMesh::uniform(2).unwrap();
    let n = mesh.num_functions();
    assert_eq!(closed(&surface(&mesh, &vec![-1.0; n], 0).unwrap()), 2);
    for value in [0.0, 1.0] {
        assert!(surface(&mesh, &vec![value; n], 0).unwrap().vertices.is_empty());
    }
}

#[test]
fn random_coefficients_make_closed_surfaces() {
    let mut state = 99;
    for round in 0..12 {
        let points: Vec<[f64; 3]> = (0..3)
            .map(|_| std::array::from_fn(|_| noise(&mut state)))
            .collect();
        let mesh = from_points(&points, &[4, 3, 5], 0, 1, 100_000).unwrap();
        let c: Vec<f64> = (0..mesh.num_functions())
            .map(|_| noise(&mut state) - 0.5)
            .collect();
        let s = surface(&mesh, &c, round % 3 - 1).unwrap();
        closed(&s);
    }
}
