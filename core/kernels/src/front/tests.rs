use super::*;
use crate::grid::Blocks;

fn ball<const D: usize>(shape: [usize; D], spacing: [f64; D], radius: f64) -> Blocks<D> {
    shape_of(shape, spacing, |x, middle| {
        (0..D).map(|a| (x[a] - middle[a]).powi(2)).sum::<f64>().sqrt() - radius
    })
}

fn shape_of<const D: usize>(
    shape: [usize; D],
    spacing: [f64; D],
    f: impl Fn(&[f64; D], &[f64; D]) -> f64,
) -> Blocks<D> {
    let middle: [f64; D] = std::array::from_fn(|a| 0.5 * (shape[a] - 1) as f64 * spacing[a]);
    let total: usize = shape.iter().product();
    let values: Vec<f64> = (0..total)
        .map(|mut k| {
            let mut x = [0.0; D];
            for a in (0..D).rev() {
                x[a] = (k % shape[a]) as f64 * spacing[a];
                k /= shape[a];
            }
            f(&x, &middle)
        })
        .collect();
    let largest = spacing.iter().fold(0.0_f64, |m, &h| m.max(h));
    Blocks::from_dense(shape, &values, 4.0 * largest).unwrap()
}

fn run<const D: usize>(front: &mut Front<D>, speed: f64, weight: f64, step: f64, steps: usize) {
    let stages = if front.order == Order::First { 1 } else { 2 };
    for _ in 0..steps {
        for stage in 0..stages {
            let (normal, smoothing) = (vec![speed; front.len()], vec![weight; front.len()]);
            let terms = Terms {
                normal: &normal,
                advection: None,
                smoothing: Some(&smoothing),
            };
            front.advance(terms, step, stage == 1).unwrap();
        }
        front.commit();
        front.check_invariants().unwrap();
    }
}

/// Mean and largest error of the zero set's radius, in spacings of one.
fn radius_error<const D: usize>(front: &Front<D>, spacing: [f64; D], radius: f64) -> (f64, f64) {
    let shape = front.blocks().shape();
    let samples = front.samples(false);
    let (mut sum, mut worst) = (0.0, 0.0_f64);
    for x in &samples.points {
        let square: f64 = (0..D)
            .map(|a| (x[a] - 0.5 * (shape[a] - 1) as f64 * spacing[a]).powi(2))
            .sum();
        let error = square.sqrt() - radius;
        sum += error;
        worst = worst.max(error.abs());
    }
    (sum / samples.points.len() as f64, worst)
}

#[test]
fn a_sphere_grows_and_shrinks_with_second_order() {
    for speed in [1.0, -1.0] {
        let mut errors = Vec::new();
        for n in [32_usize, 64] {
            let radius = n as f64 / 4.0;
            let mut front = Front::new(&ball([n; 3], [1.0; 3], radius), [1.0; 3], 3, Order::Second).unwrap();
            run(&mut front, speed, 0.0, 0.32, n / 3);
            let end = radius + speed * 0.32 * (n / 3) as f64;
            errors.push(radius_error(&front, [1.0; 3], end).1);
        }
        // In spacings: an error of second order halves when the spacing does.
        assert!(
            errors[1] < 0.04 && errors[1] < 0.65 * errors[0],
            "{speed}: {errors:?}"
        );
    }
}

#[test]
fn circles_and_spheres_shorten_by_their_curvature() {
    let mut front = Front::new(&ball([48; 2], [1.0; 2], 16.0), [1.0; 2], 3, Order::Second).unwrap();
    run(&mut front, 0.0, 1.0, 0.2, 200);
    assert!(radius_error(&front, [1.0; 2], (256.0_f64 - 80.0).sqrt()).1 < 0.02);
    let mut front = Front::new(&ball([40; 3], [1.0; 3], 14.0), [1.0; 3], 3, Order::Second).unwrap();
    run(&mut front, 0.0, 1.0, 0.15, 120);
    assert!(radius_error(&front, [1.0; 3], (196.0_f64 - 72.0).sqrt()).1 < 0.02);
}

#[test]
fn spacings_may_differ() {
    let errors = [1.0, 0.5].map(|scale| {
        let spacing = [0.5, 1.0, 0.7].map(|h| h * scale);
        let shape = [81, 41, 58].map(|n| (n as f64 / scale) as usize);
        let mut front = Front::new(&ball(shape, spacing, 10.0), spacing, 3, Order::Second).unwrap();
        run(&mut front, 1.0, 0.0, 0.15 * scale, (20.0 / scale) as usize);
        radius_error(&front, spacing, 13.0).1
    });
    assert!(errors[0] < 0.02 && errors[1] < 0.35 * errors[0], "{errors:?}");
}

#[test]
fn whitakers_layers_err_by_a_part_of_a_spacing() {
    let mut front = Front::new(&ball([64; 3], [1.0; 3], 16.0), [1.0; 3], 2, Order::First).unwrap();
    run(&mut front, 1.0, 0.0, 1.0 / 3.0, 18);
    let (mean, worst) = radius_error(&front, [1.0; 3], 22.0);
    assert!(mean.abs() < 0.25 && worst < 0.5);
}

#[test]
fn two_balls_merge_and_a_dumbbell_splits() {
    let balls = |x: &[f64; 3], m: &[f64; 3]| {
        let d =
            |s: f64| ((x[0] - m[0] - s).powi(2) + (x[1] - m[1]).powi(2) + (x[2] - m[2]).powi(2)).sqrt() - 8.0;
        d(-10.0).min(d(10.0))
    };
    for order in [Order::First, Order::Second] {
        let blocks = shape_of([56, 40, 40], [1.0; 3], balls);
        let mut front = Front::new(&blocks, [1.0; 3], 3, order).unwrap();
        run(&mut front, 1.0, 0.0, 0.3, 16);
        run(&mut front, -1.0, 0.0, 0.3, 60);
        assert!(front.is_empty(), "{order:?}");
        assert!(front.blocks().to_dense().iter().all(|v| *v > 0.0));
    }
}

#[test]
fn a_front_may_leave_the_grid() {
    for order in [Order::First, Order::Second] {
        let mut front = Front::new(&ball([21, 30], [1.0; 2], 8.0), [1.0; 2], 3, order).unwrap();
        run(&mut front, 1.0, 0.0, 0.45, 40);
        assert!(front.blocks().to_dense().iter().all(|v| *v < 0.0), "{order:?}");
    }
}

#[test]
fn nothing_moves_without_speed() {
    let mut front = Front::new(&ball([40; 3], [1.0; 3], 12.0), [1.0; 3], 3, Order::Second).unwrap();
    let before = front.blocks().to_dense();
    run(&mut front, 0.0, 0.0, 0.3, 5);
    for (a, b) in front.blocks().to_dense().iter().zip(&before) {
        assert!(a.to_bits() == b.to_bits() || b.abs() > 2.5);
    }
}

#[test]
fn bad_terms_are_refused() {
    let mut front = Front::new(&ball([20; 2], [1.0; 2], 6.0), [1.0; 2], 3, Order::Second).unwrap();
    let normal = vec![f64::NAN; front.len()];
    let terms = Terms {
        normal: &normal,
        advection: None,
        smoothing: None,
    };
    assert!(front.advance(terms, 0.1, false).is_err());
    let terms = Terms {
        normal: &[1.0],
        advection: None,
        smoothing: None,
    };
    assert!(front.advance(terms, 0.1, false).is_err());
}

#[test]
fn a_narrower_band_is_filled_up() {
    let shape = [40; 3];
    let wide = ball(shape, [1.0; 3], 12.0);
    let narrow = Blocks::from_dense(shape, &wide.to_dense(), 1.5).unwrap();
    let front = Front::new(&narrow, [1.0; 3], 3, Order::Second).unwrap();
    front.check_invariants().unwrap();
    for (a, b) in front.blocks().to_dense().iter().zip(&wide.to_dense()) {
        assert!(a.abs() >= 4.0 || (a - b).abs() < 0.02, "{a} {b}");
    }
}
