use super::*;

fn dense(shape: [usize; 3]) -> Vec<f64> {
    (0..shape.iter().product::<usize>())
        .map(|k| ((k * 7919) % 1009) as f64 - 500.25)
        .collect()
}

#[test]
fn a_dense_array_comes_back() {
    let shape = [9, 17, 8];
    let values = dense(shape);
    let blocks = Blocks::from_dense(shape, &values, f64::INFINITY).unwrap();
    assert_eq!(blocks.len(), 2 * 3);
    assert_eq!(blocks.to_dense(), values);
}

#[test]
fn neighbours_are_those_of_the_array() {
    let shape = [13, 10, 21];
    let values = dense(shape);
    let blocks = Blocks::from_dense(shape, &values, f64::INFINITY).unwrap();
    for (slot, place) in blocks.places().iter().enumerate() {
        for offset in (0..512).filter(|&o| blocks.on_grid(place, o)) {
            let node = Blocks::<3>::node(place, offset);
            for axis in 0..3 {
                for step in -3_isize..=3 {
                    let mut at = node;
                    at[axis] = at[axis].saturating_add_signed(step).min(shape[axis] - 1);
                    let expected = values[(at[0] * shape[1] + at[1]) * shape[2] + at[2]];
                    assert_eq!(
                        blocks.beside(blocks.values(), slot, offset, axis, step).to_bits(),
                        expected.to_bits()
                    );
                    assert_eq!(blocks.at(at.map(|x| x as i64)).to_bits(), expected.to_bits());
                }
            }
        }
    }
}

#[test]
fn far_blocks_keep_their_sign_only() {
    let shape = [64, 64];
    let circle: Vec<f64> = (0..64 * 64)
        .map(|k| f64::hypot((k / 64) as f64 - 31.0, (k % 64) as f64 - 33.0) - 20.0)
        .collect();
    let mut blocks = Blocks::from_dense(shape, &circle, 3.0).unwrap();
    assert!(blocks.len() < 40);
    for (k, d) in blocks.to_dense().iter().zip(&circle).map(|(v, d)| (*v, *d)) {
        assert_eq!(k.to_bits(), d.clamp(-3.0, 3.0).to_bits());
    }
    let before = blocks.to_dense();
    // Storing and dropping what is uniform changes nothing.
    let all: Vec<[u32; 2]> = (0..8).flat_map(|x| (0..8).map(move |y| [x, y])).collect();
    blocks.store(&all);
    assert_eq!(blocks.len(), 64);
    assert_eq!(blocks.to_dense(), before);
    let kept: Vec<bool> = blocks
        .values()
        .chunks(64)
        .map(|c| c.iter().any(|v| v.abs() < 3.0))
        .collect();
    blocks.keep(&kept);
    assert_eq!(blocks.to_dense(), before);
    let inside = blocks.inside();
    let again = Blocks::from_parts(shape, 3.0, blocks.places(), blocks.values(), &inside).unwrap();
    assert_eq!(again.to_dense(), before);
}
