//! Light along a step.

use super::support::{Point, Probe, judge};
use skycell_server::probe::FunctionQuestion as Question;
use skycell_tests::numbers::{U, worst};

#[test]
fn the_share_of_a_constant_source_is_right_from_thin_to_opaque() {
    let mut points: Vec<Point> = (0..12_000)
        .map(|index| 10f64.powf(-12.0 + 14.0 * f64::from(index) / 11_999.0))
        .map(|x| [[x as f32, 0.0, 0.0, 0.0], [0.0; 4]])
        .collect();
    // Both sides of the change of formula.
    points.extend(
        [0.0, 0.01f32.next_down(), 0.01, 0.01f32.next_up()].map(|x| [[x, 0.0, 0.0, 0.0], [0.0; 4]]),
    );
    let values = Probe::open().ask(Question::OneMinusExpOver, &points);
    // Above the change at 1e-2, e^-x is known to (3 + 2 x) units (WGSL) and cancels against 1: at most 3.5 · 2 U / 1e-2.
    let bound = 7.0 * U / 1e-2;
    let twin = |x: f64| if x == 0.0 { 1.0 } else { -(-x).exp_m1() / x };
    let check = |value: &dyn Fn(usize) -> f64| {
        worst(points.iter().enumerate().map(|(index, point)| {
            let exact = twin(point[0][0].into());
            ((value(index) / exact - 1.0).abs(), bound)
        }))
    };
    let gpu = check(&|index| values[index][0].into());
    // Unguarded.
    let defect = check(&|index| {
        let x = points[index][0][0];
        ((1.0 - (-x).exp()) / x).into()
    });
    judge("(1 - e^-x) / x", points.len(), gpu, defect);
}
