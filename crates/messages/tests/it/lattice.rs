//! Laws of the lattice family, and its moments against those of a Gaussian.

use nalgebra::{Matrix2, Vector2};
use proptest::prelude::*;
use std::sync::Arc;
use sumprod_graph::{Coordinate, Message, MessageError, Messages, Purpose, Space, Stream};
use sumprod_messages::{Cell, Gaussian, Lattice, LatticeForm, LatticeMessage};

const FORM: LatticeForm = LatticeForm::Lattice { width: 1.0, most: 1000 };

/// The square of cells around the origin.
fn square(half: i32) -> Arc<[Cell]> {
    (-half..half).flat_map(|i| (-half..half).map(move |j| [i, j])).collect()
}

fn product(messages: &[LatticeMessage], form: LatticeForm) -> LatticeMessage {
    let edges: Vec<u32> = (0..messages.len() as u32).collect();
    let mut stream = Stream::new(1, 0, Purpose::Belief, 0);
    LatticeMessage::product(Messages::new(messages, &edges), &form, &mut stream).unwrap()
}

fn message(width: f64, cells: &Arc<[Cell]>, log_values: Vec<f64>) -> LatticeMessage {
    Lattice::new(width, cells.clone(), log_values, -20.0).unwrap().into()
}

fn gaussian(mean: [f64; 2], covariance: [f64; 3]) -> Gaussian<2> {
    let [xx, xy, yy] = covariance;
    Gaussian::from_moments(Vector2::from(mean), Matrix2::new(xx, xy, xy, yy)).unwrap()
}

fn assert_close(a: &LatticeMessage, b: &LatticeMessage) {
    let (a, b) = (a.lattice().unwrap(), b.lattice().unwrap());
    assert_eq!(a.cells(), b.cells());
    for (a, b) in a.log_values().iter().zip(b.log_values()) {
        assert!((a - b).abs() < 1e-9, "{a} {b}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn products_commute_and_quotients_undo_them(
        values in prop::collection::vec(prop::collection::vec(-8.0f64..0.0, 16), 3),
        mean in prop::array::uniform2(-2.0f64..2.0),
    ) {
        let cells = square(2);
        let mut all: Vec<LatticeMessage> =
            values.into_iter().map(|values| message(1.0, &cells, values)).collect();
        all.push(gaussian(mean, [2.0, 0.5, 1.0]).into());
        let whole = product(&all, FORM);
        prop_assert_eq!(whole.change(&whole), 0.0);
        let reversed: Vec<_> = all.iter().rev().cloned().collect();
        assert_close(&whole, &product(&reversed, FORM));
        let vacuous = LatticeMessage::vacuous(&Space::real(2));
        assert_close(&whole, &product(&[&all[..], &[vacuous]].concat(), FORM));
        for part in 0..all.len() {
            let rest: Vec<_> = (0..all.len()).filter(|&k| k != part).map(|k| all[k].clone()).collect();
            let quotient = whole.quotient(&all[part]).unwrap();
            let mut again = product(&[quotient, vacuous_lattice(&cells)], FORM);
            assert_close(&again, &product(&rest, FORM));
            prop_assert!(again.damp(&whole, 1.0));
            assert_close(&again, &whole);
        }
    }
}

fn vacuous_lattice(cells: &Arc<[Cell]>) -> LatticeMessage {
    message(1.0, cells, vec![0.0; cells.len()])
}

#[test]
fn a_gaussian_on_fine_cells_has_its_own_moments() {
    let expected = gaussian([0.3, -0.7], [4.0, 1.0, 2.0]);
    let width = 0.25;
    let cells = square(48);
    let flat = message(width, &cells, vec![0.0; cells.len()]);
    let form = LatticeForm::Lattice { width, most: usize::MAX };
    let belief = product(&[flat, expected.into()], form);
    let (mean, covariance) = belief.moments().unwrap();
    // Each cell is uniform, which adds width²/12 along both axes.
    let spread = Matrix2::identity() * (width * width / 12.0);
    assert!((mean - Vector2::new(0.3, -0.7)).norm() < 1e-6, "{mean}");
    assert!((covariance - Matrix2::new(4.0, 1.0, 1.0, 2.0) - spread).norm() < 1e-4, "{covariance}");
    // In Gaussian form it is read by these moments, at nearly no cost.
    let read = product(&[belief], LatticeForm::default());
    assert!((read.moments().unwrap().0 - mean).norm() < 1e-9);
    assert!(read.quality().conversion_loss.unwrap() < 0.01);
    let two = message(1.0, &Arc::from([[-20, 0], [20, 0]]), vec![0.0, 0.0]);
    let loss = product(&[two], LatticeForm::default()).quality().conversion_loss.unwrap();
    // Two cells 40 m apart: ½ ln |2πe P| - ln 2 with P = diag(400 + 1/12, 1/12).
    let expected =
        (std::f64::consts::TAU * std::f64::consts::E * (400.0f64 + 1.0 / 12.0).sqrt() / 12f64.sqrt()).ln()
            - 2f64.ln();
    assert!((loss - expected).abs() < 1e-9, "{loss} {expected}");
}

#[test]
fn finer_cells_keep_the_places_and_the_most_likely_are_kept() {
    let coarse = message(4.0, &Arc::from([[0, 0], [2, -1]]), vec![0.0, -1.0]);
    let fine = product(std::slice::from_ref(&coarse), LatticeForm::Lattice { width: 2.0, most: 100 });
    let lattice = fine.lattice().unwrap();
    assert_eq!(lattice.cells()[..], [[0, 0], [0, 1], [1, 0], [1, 1], [4, -2], [4, -1], [5, -2], [5, -1]]);
    assert!((fine.moments().unwrap().0 - coarse.moments().unwrap().0).norm() < 1e-12);
    assert!((lattice.effective_cells() - 4.0 * coarse.lattice().unwrap().effective_cells()).abs() < 1e-9);
    let few = product(&[coarse], LatticeForm::Lattice { width: 2.0, most: 4 });
    assert_eq!(few.lattice().unwrap().cells()[..], [[0, 0], [0, 1], [1, 0], [1, 1]]);
    assert_eq!(few.lattice().unwrap().log_at([-50.0, 3.0]), few.lattice().unwrap().outside());
}

#[test]
fn messages_on_other_cells_meet_where_the_fewest_are() {
    let (narrow, wide) = (square(1), square(3));
    let wide = message(1.0, &wide, (0..36).map(|k| -0.1 * f64::from(k)).collect());
    let both = product(&[wide.clone(), vacuous_lattice(&narrow)], FORM);
    let lattice = both.lattice().unwrap();
    assert_eq!(lattice.cells(), &narrow);
    for (&cell, value) in lattice.cells().iter().zip(lattice.log_values()) {
        let expected = wide.lattice().unwrap().log_at(lattice.centre(cell));
        let first = wide.lattice().unwrap().log_at(lattice.centre([-1, -1]));
        assert!((value - (expected - first)).abs() < 1e-12);
    }
    // Places that no message names are outliers to all, and no error.
    let far = message(1.0, &Arc::from([[90, 90]]), vec![0.0]);
    let apart = product(&[far, vacuous_lattice(&narrow)], FORM);
    assert_eq!(apart.lattice().unwrap().cells().len(), 1);
}

#[test]
fn what_is_no_lattice_is_refused() {
    let cells = square(1);
    let wrong = Lattice::new(1.0, cells.clone(), vec![0.0; 3], 0.0).unwrap_err();
    assert!(matches!(wrong, MessageError::Dimension { found: 3, expected: 4, .. }));
    assert!(Lattice::new(0.0, cells.clone(), vec![0.0; 4], 0.0).is_err());
    assert!(Lattice::new(1.0, Arc::from([[1, 0], [0, 0]]), vec![0.0; 2], 0.0).is_err());
    assert!(Lattice::new(1.0, Arc::from([]), vec![], 0.0).is_err());
    let error = Lattice::new(1.0, cells, vec![f64::NAN; 4], 0.0).unwrap_err();
    assert!(matches!(error, MessageError::NotFinite { .. }));
    let form =
        |width, most| LatticeMessage::check_form(&LatticeForm::Lattice { width, most }, &Space::real(2));
    assert!(form(1.0, 1).is_ok());
    assert!(form(-1.0, 1).unwrap_err().contains("-1 m wide"));
    assert!(form(1.0, 0).is_err());
    let pose = Space::new([Coordinate::Real, Coordinate::Angle]);
    assert!(LatticeMessage::check_form(&FORM, &pose).is_err());
}
