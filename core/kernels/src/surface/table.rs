//! Dual marching cubes in one cube: which of its crossed edges lie on one patch of the surface.
//!
//! Corner k of a cube is the upper one along axis a iff bit a of k is 1. Edge `4 a + p + 2 q` runs along axis a at the
//! lower (0) or upper (1) side of the axes a + 1 and a + 2. Face `2 a + s` is the lower or upper one of axis a.
//!
//! On each face the crossed edges are joined in pairs; over the cube they make closed loops, and each loop is a vertex of
//! the dual surface (Nielson, "Dual marching cubes", IEEE Visualization 2004, doi 10.1109/VISUAL.2004.28). A face with
//! alternating signs is ambiguous: its two inside corners are kept apart. The rule looks at the face alone, so that
//! cubes on both sides agree. A few signs (Nielson's C16 and C19) put both joints of their only ambiguous face on one
//! loop; where two such cubes share that face, four triangles would meet in one edge of the surface. There both cubes
//! join the inside corners instead, which makes two loops of one (Wenger, "Isosurfaces", CRC Press 2013, section 3.3).

use std::sync::OnceLock;

/// No loop, no face.
pub const NONE: u8 = u8::MAX;

/// Loops of one cube.
#[derive(Debug, Clone, Copy)]
pub struct Patches {
    /// Number of loops.
    pub count: u8,
    /// The loop of each edge; `NONE` where the edge is not crossed.
    pub of_edge: [u8; 12],
}

/// Loops for every choice of inside corners (bit k: corner k is inside).
pub struct Table {
    plain: [Patches; 256],
    /// With the rule turned round on the face of `pinched`.
    turned: [Patches; 256],
    /// The ambiguous face whose joints lie on one loop.
    pinched: [u8; 256],
}

impl Table {
    /// Loops of a cube.
    #[inline]
    pub fn patches(&self, case: u8, turned: bool) -> &Patches {
        if turned {
            &self.turned[case as usize]
        } else {
            &self.plain[case as usize]
        }
    }

    /// The face across which a cube of the same kind would pinch the surface, or `NONE`.
    #[inline]
    pub fn pinched(&self, case: u8) -> u8 {
        self.pinched[case as usize]
    }
}

/// The table, made on first use.
pub fn table() -> &'static Table {
    static TABLE: OnceLock<Table> = OnceLock::new();
    TABLE.get_or_init(|| {
        let mut table = Table {
            plain: std::array::from_fn(|case| patches(case as u8, NONE)),
            turned: std::array::from_fn(|case| patches(case as u8, NONE)),
            pinched: [NONE; 256],
        };
        for case in 0..=255_u8 {
            let found = (0..6).find(|&face| is_pinched(case, face, &table.plain[case as usize]));
            if let Some(face) = found {
                table.pinched[case as usize] = face;
                table.turned[case as usize] = patches(case, face);
            }
        }
        table
    })
}

/// Lower and upper corner of an edge.
#[inline]
pub fn ends(edge: usize) -> [usize; 2] {
    let a = edge / 4;
    let low = (edge & 1) << ((a + 1) % 3) | ((edge >> 1) & 1) << ((a + 2) % 3);
    [low, low | 1 << a]
}

/// Corners of a face in cyclic order.
fn ring(face: u8) -> [u8; 4] {
    let (a, side) = (face / 2, face % 2);
    let (b, c) = ((a + 1) % 3, (a + 2) % 3);
    let base = side << a;
    [base, base | 1 << b, base | 1 << b | 1 << c, base | 1 << c]
}

/// The edge between two neighbouring corners.
fn edge_between(p: u8, q: u8) -> u8 {
    let a = (p ^ q).trailing_zeros() as u8;
    let bit = |axis: u8| (p >> (axis % 3)) & 1;
    4 * a + bit(a + 1) + 2 * bit(a + 2)
}

fn is_ambiguous(case: u8, face: u8) -> bool {
    let r = ring(face).map(|k| case >> k & 1);
    r[0] == r[2] && r[1] == r[3] && r[0] != r[1]
}

/// The two crossed edges of a face at its k-th corner.
fn corner_edges(face: u8, k: usize) -> [u8; 2] {
    let r = ring(face);
    [
        edge_between(r[(k + 3) % 4], r[k]),
        edge_between(r[k], r[(k + 1) % 4]),
    ]
}

fn is_pinched(case: u8, face: u8, patches: &Patches) -> bool {
    is_ambiguous(case, face) && {
        let of = corner_edges(face, 0).map(|e| patches.of_edge[e as usize]);
        let opposite = corner_edges(face, 2).map(|e| patches.of_edge[e as usize]);
        of[0] == opposite[0] && of[1] == opposite[1] && of[0] == of[1]
    }
}

/// The loops, inside corners joined on the face `turned` if it is ambiguous, else kept apart.
fn patches(case: u8, turned: u8) -> Patches {
    let inside = |k: u8| case >> k & 1 == 1;
    // Every crossed edge points to another of its loop; roots name the loops.
    let mut parent: [u8; 12] = std::array::from_fn(|e| e as u8);
    let root = |parent: &[u8; 12], mut e: u8| {
        while parent[e as usize] != e {
            e = parent[e as usize];
        }
        e
    };
    let mut join = |[p, q]: [u8; 2]| {
        let (p, q) = (root(&parent, p), root(&parent, q));
        parent[p.max(q) as usize] = p.min(q);
    };
    for face in 0..6 {
        let r = ring(face);
        if is_ambiguous(case, face) {
            for k in (0..4).filter(|&k| inside(r[k]) != (face == turned)) {
                join(corner_edges(face, k));
            }
            continue;
        }
        let crossed: Vec<u8> = (0..4)
            .filter(|&k| inside(r[k]) != inside(r[(k + 1) % 4]))
            .map(|k| edge_between(r[k], r[(k + 1) % 4]))
            .collect();
        if let [p, q] = crossed[..] {
            join([p, q]);
        }
    }
    let mut found = Patches {
        count: 0,
        of_edge: [NONE; 12],
    };
    for e in 0..12_u8 {
        let [low, high] = ends(e as usize);
        if inside(low as u8) == inside(high as u8) {
            continue;
        }
        let first = root(&parent, e);
        found.of_edge[e as usize] = if first == e {
            found.count += 1;
            found.count - 1
        } else {
            found.of_edge[first as usize]
        };
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_join_neighbouring_corners() {
        for e in 0..12 {
            let [low, high] = ends(e);
            assert_eq!(usize::from(edge_between(low as u8, high as u8)), e);
            assert_eq!(usize::from(edge_between(high as u8, low as u8)), e);
        }
    }

    #[test]
    fn loops_have_three_edges_at_least_and_cover_the_crossed_ones() {
        for case in 0..=255_u8 {
            for turned in [false, true] {
                let p = table().patches(case, turned);
                for e in 0..12 {
                    let [low, high] = ends(e);
                    assert_eq!(p.of_edge[e] == NONE, case >> low & 1 == case >> high & 1);
                }
                for k in 0..p.count {
                    assert!((0..12).filter(|&e| p.of_edge[e] == k).count() >= 3);
                }
            }
        }
    }

    /// What the repair rests on: a pinched face is the cube's only ambiguous one, so that no third cube is concerned, and
    /// turning it round parts the two joints.
    #[test]
    fn a_pinched_face_is_the_only_ambiguous_one() {
        let mut count = 0;
        for case in 0..=255_u8 {
            let face = table().pinched(case);
            if face == NONE {
                continue;
            }
            count += 1;
            assert_eq!((0..6).filter(|&f| is_ambiguous(case, f)).count(), 1, "{case}");
            let turned = table().patches(case, true);
            let outside = (0..4).filter(|&k| case >> ring(face)[k] & 1 == 0);
            let loops: Vec<u8> = outside
                .map(|k| turned.of_edge[corner_edges(face, k)[0] as usize])
                .collect();
            assert_ne!(loops[0], loops[1]);
        }
        assert!(count > 0);
    }
}
