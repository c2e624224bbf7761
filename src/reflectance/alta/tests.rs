//! Tests of the reader on files made here.

use proptest::prelude::*;
use std::fmt::Write as _;
use std::sync::LazyLock;

use super::super::test_support::*;
use super::*;

const HEADER: &str =
    "#SAMPLE \"made\"\n#DIM 3 1\n#VS 0\n#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI\n#PARAM_OUT INV_STERADIAN_COSINE_FACTOR\n";

/// View directions on a grid of two degrees, f cos(theta_o) given for theta_i, theta_o cos(dphi), theta_o sin(dphi).
fn file(header: &str, incidences_deg: &[f64], f_cos_o: impl Fn(f64, f64, f64) -> f64) -> String {
    let mut text = header.to_owned();
    for theta_i in incidences_deg.iter().map(|t| t.to_radians()) {
        for (i, j) in (-45..=45).flat_map(|i| (-45..=45).map(move |j| (i, j))) {
            let (x, y) = (f64::from(2 * i).to_radians(), f64::from(2 * j).to_radians());
            if x.hypot(y) <= FRAC_PI_2 {
                writeln!(text, "{theta_i} {x} {y}\t{}", f_cos_o(theta_i, x, y)).unwrap();
            }
        }
    }
    text
}

/// A diffuser with a lobe of height 2 where wi = wo and one of height 1 in the mirror direction, both 6 deg wide.
fn two_lobes(theta_i: f64, x: f64, y: f64) -> f64 {
    let lobe = |centre: f64| (-((x - centre).powi(2) + y * y) / 0.1f64.powi(2)).exp();
    0.2 * x.hypot(y).cos() + 2.0 * lobe(theta_i) + lobe(-theta_i)
}

static TAPE: LazyLock<Alta> =
    LazyLock::new(|| Alta::parse(file(HEADER, &[20.0, 40.0], two_lobes).as_bytes(), "tape").unwrap());

fn f_cos_o(theta_i_deg: f64, theta_o_deg: f64, dphi: f64) -> f64 {
    let (wi, wo) = (
        Direction::from_angles(theta_i_deg.to_radians(), 0.7),
        Direction::from_angles(theta_o_deg.to_radians(), 0.7 + dphi),
    );
    TAPE.eval(&wi, &wo)[1] * wo.cos_theta()
}

#[test]
fn lobes_stay_where_they_belong_between_and_beyond_the_incidences() {
    // Halfway a lobe is the mean of two moved ones; a moved point lies between those of the file.
    const INTERPOLATION: f64 = 0.05;
    for theta in [20.0, 25.0, 30.0, 40.0, 55.0] {
        let (back, mirror) = (f_cos_o(theta, theta, 0.0), f_cos_o(theta, theta, std::f64::consts::PI));
        let base = 0.2 * 30f64.to_radians().cos();
        assert!((back / (2.0 + base) - 1.0).abs() < INTERPOLATION, "{theta}: {back}");
        assert!((mirror / (1.0 + base) - 1.0).abs() < INTERPOLATION, "{theta}: {mirror}");
        assert!(f_cos_o(theta, theta + 6.0, 0.0) < 0.6 * back && f_cos_o(theta, theta - 6.0, 0.0) < 0.6 * back);
    }
}

#[test]
fn values_without_the_cosine_mean_the_same() {
    let header = HEADER.replace("_COSINE_FACTOR", "");
    let plain = |t, x: f64, y: f64| two_lobes(t, x, y) / x.hypot(y).cos();
    let other = Alta::parse(file(&header, &[20.0, 40.0], plain).as_bytes(), "tape").unwrap();
    let (wi, wo) = (Direction::from_angles(0.5, 1.0), Direction::from_angles(0.8, 1.4));
    let (f, g) = (TAPE.eval(&wi, &wo)[0], other.eval(&wi, &wo)[0]);
    assert!((f / g - 1.0).abs() < 1e-9, "{f} against {g}");
    assert_eq!(TAPE.theta_i().map(|t| t.to_degrees().round()).collect::<Vec<_>>(), [20.0, 40.0]);
}

#[test]
fn is_black_below_and_continuous() {
    black_below(&*TAPE);
    continuous_over_the_wrap(&*TAPE);
}

#[test]
fn intervals_of_confidence_are_passed_over() {
    let with_bounds = file(&HEADER.replace("#VS 0", "#VS 2"), &[20.0, 40.0], two_lobes)
        .lines()
        .map(|l| if l.starts_with('#') { format!("{l}\n") } else { format!("{l} 0 9\n") })
        .collect::<String>();
    let other = Alta::parse(with_bounds.as_bytes(), "tape").unwrap();
    let (wi, wo) = (Direction::from_angles(0.5, 1.0), Direction::from_angles(0.8, 1.4));
    assert_eq!(TAPE.eval(&wi, &wo), other.eval(&wi, &wo));
}

#[test]
fn damage_is_named_by_its_line() {
    let whole = file(HEADER, &[20.0], two_lobes);
    let error = |text: &str| Alta::parse(text.as_bytes(), "bad.dat").unwrap_err();
    let line_6 = whole.lines().nth(5).unwrap();
    for (from, to, word) in [
        (line_6, "0.3 0.1 0.2", "4 finite numbers"),
        (line_6, "0.3 0.1 0.2 0.5 0.6", "4 finite numbers"),
        (line_6, "0.3 0.1 NaN 0.5", "4 finite numbers"),
        (line_6, "0.3 0.1 x 0.5", "`0.3 0.1 x 0.5`"),
        (line_6, "1.7 0.1 0.2 0.5", "pi/2"),
        (line_6, "-0.1 0.1 0.2 0.5", "pi/2"),
        (line_6, "0.3 1.5 1.5 0.5", "pi/2"),
        (line_6, "0.3 0.1 0.2 0.5", "1 for 17.189 deg"),
        ("#DIM 3 1\n", "#\n", "#DIM"),
        ("#PARAM_IN ", "#", "#PARAM_IN"),
        ("#PARAM_OUT ", "#", "#PARAM_OUT"),
    ] {
        let damaged = whole.replacen(from, to, 1);
        let error = error(&damaged);
        assert!(matches!(error, ReadError::Invalid { .. }), "{error}");
        let said = error.to_string();
        assert!(said.contains("bad.dat: line 6: ") && said.contains(word), "{said}");
    }
    for (from, to, line) in [
        ("DIM 3 1", "DIM 2 1", "line 2"),
        ("#VS 0", "#VS 3", "line 3"),
        ("ISOTROPIC_TL_TV_PROJ_DPHI", "RUSIN_TH_TD", "line 4"),
        ("INV_STERADIAN_COSINE_FACTOR", "ENERGY", "line 5"),
        ("#SAMPLE \"made\"", "#FORMAT binary", "line 1"),
    ] {
        let error = error(&whole.replacen(from, to, 1));
        assert!(matches!(error, ReadError::NotSupported { .. }) && error.to_string().contains(line), "{error}");
    }
    assert!(error("").to_string().contains("line 0") && error(HEADER).to_string().contains("line 5"));
    assert!(error(&whole[..HEADER.len() + 100]).to_string().contains("line"));
}

proptest! {
    #[test]
    fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200), header in any::<bool>()) {
        let mut whole = if header { HEADER.as_bytes().to_vec() } else { Vec::new() };
        whole.extend(bytes);
        prop_assert!(Alta::parse(&whole, "random").is_err());
    }

    #[test]
    fn any_points_give_finite_values(
        rows in proptest::collection::vec((0.0..1.5f64, 0.0..1.57f64, 0.0..6.3f64, -1.0..1e9f64), NEIGHBOURS + 1..60),
        same_place in any::<bool>(), wi in upper(), wo in upper(),
    ) {
        let mut text = HEADER.to_owned();
        for (theta_i, theta_o, dphi, value) in rows {
            let (i, o) = if same_place { (0.5, 0.4) } else { ((theta_i * 2.0).round() / 2.0, theta_o) };
            writeln!(text, "{i} {} {} {value}", o * dphi.cos(), o * dphi.sin()).unwrap();
        }
        if let Ok(alta) = Alta::parse(text.as_bytes(), "random") {
            prop_assert!(alta.eval(&wi, &wo)[0].is_finite() && alta.eval(&wi, &wo)[0] >= 0.0);
        }
    }
}
