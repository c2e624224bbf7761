//! Tests of the reader and of the evaluation on small files made here.

use proptest::prelude::*;

use super::super::TensorWriter;
use super::super::test_support::*;
use super::*;

const PI_F32: f32 = std::f32::consts::PI;
/// Mitsuba computes in f32: its polar angles err by some 1e-7, which the tables multiply.
const MITSUBA_F32: f64 = 2e-5;

enum Data {
    U8(Vec<u8>),
    F32(Vec<f32>),
}

type Field = (&'static str, Vec<usize>, Data);

/// Multiples of 1/64, exact in f32, that look like nothing in particular; as in `tests/python/rgl_golden.py`.
fn pattern(name: &'static str, shape: &[usize], step: i64, low: i64) -> Field {
    let count: usize = shape.iter().product();
    let values = (0..count as i64).map(|k| ((k * step) % 64 + low) as f32 / 64.0).collect();
    (name, shape.to_vec(), Data::F32(values))
}

fn synthetic(phi: &[f32], jacobian: u8) -> Vec<Field> {
    let (p, t) = (phi.len(), 3);
    vec![
        ("description", vec![9], Data::U8(b"synthetic".to_vec())),
        ("jacobian", vec![1], Data::U8(vec![jacobian])),
        ("phi_i", vec![p], Data::F32(phi.to_vec())),
        ("theta_i", vec![t], Data::F32(vec![0.0, 0.6, PI_F32 / 2.0])),
        pattern("ndf", &[3, 5], 37, 8),
        // Step 16 makes both rows equal, as in isotropic files.
        pattern("sigma", &[2, 4], if p == 1 { 16 } else { 23 }, 16),
        pattern("vndf", &[p, t, 7, 6], 41, 4),
        pattern("luminance", &[p, t, 4, 4], 29, 4),
        pattern("rgb", &[p, t, 3, 4, 4], 29, -8),
    ]
}

fn tensor_file(fields: &[Field]) -> Vec<u8> {
    let mut file = TensorWriter::default();
    for (name, shape, values) in fields {
        match values {
            Data::U8(bytes) => file.u8(name, bytes),
            Data::F32(numbers) => file.f32(name, shape, numbers),
        }
    }
    file.to_bytes()
}

fn named(name: &str) -> Rgl {
    let (phi, jacobian): (&[f32], u8) = match name {
        "synthetic-isotropic" => (&[0.0], 1),
        "synthetic-no-jacobian" => (&[0.0], 0),
        "synthetic-full" => (&[-PI_F32, -1.0, 1.0, PI_F32], 1),
        "synthetic-half-turn" => (&[-PI_F32, -2.0, 0.0], 1),
        "synthetic-both-axes" => (&[-PI_F32, -2.0, -PI_F32 / 2.0], 1),
        _ => panic!("{name} is made by rgl_golden.py only"),
    };
    Rgl::parse(&tensor_file(&synthetic(phi, jacobian)), name).unwrap()
}

#[test]
fn agrees_with_mitsuba() {
    let golden: std::collections::BTreeMap<String, Vec<[f64; 7]>> =
        serde_json::from_str(include_str!("../../../tests/golden/rgl_mitsuba.json")).unwrap();
    let mut files = 0;
    for (name, rows) in golden.iter().filter(|(name, _)| name.starts_with("synthetic")) {
        files += 1;
        let rgl = named(name);
        assert_eq!(rows.len(), 40);
        for [theta_i, phi_i, theta_o, phi_o, want @ ..] in rows {
            let (wi, wo) = (Direction::from_angles(*theta_i, *phi_i), Direction::from_angles(*theta_o, *phi_o));
            for (got, want) in rgl.eval_cos(&wi, &wo).into_iter().zip(want) {
                let want = want.max(0.0);
                assert!((got - want).abs() <= MITSUBA_F32 * want.max(0.01), "{name}: {got} instead of {want}");
            }
        }
    }
    assert_eq!(files, 5);
}

#[test]
fn the_camera_indexes_the_table_and_the_light_carries_the_cosine() {
    // Without ndf and sigma and with one colour everywhere, f cos(theta_i) is that colour.
    let mut fields = synthetic(&[0.0], 0);
    for field in &mut fields {
        if let ("rgb", _, Data::F32(values)) = field {
            values.fill(0.25);
        }
    }
    let rgl = Rgl::parse(&tensor_file(&fields), "gray").unwrap();
    let (wi, wo) = (Direction::from_angles(0.4, 0.3), Direction::from_angles(1.2, 2.0));
    assert!((rgl.eval(&wi, &wo)[0] - 0.25 / wi.cos_theta()).abs() < 1e-7);
    // A vndf whose slices differ shows which direction selects the slice: swapped arguments give something else.
    let rgl = named("synthetic-isotropic");
    assert!((rgl.eval(&wi, &wo)[0] / rgl.eval(&wo, &wi)[0] - 1.0).abs() > 0.1);
}

#[test]
fn unflatten_is_the_inverse_of_flatten() {
    // Integrals are stored in f32; near the ends of a row a density of 4/64 divides their rounding.
    const F32: f64 = 1e-5;
    let ("vndf", shape, Data::F32(density)) = pattern("vndf", &[7, 6], 41, 4) else { unreachable!() };
    let flattening = Flattening::new(shape[1], shape[0], &density).unwrap();
    for k in 0..300 {
        let (s, t) = ((k as f64 * 0.618).fract(), k as f64 / 299.0);
        let (u, v) = flattening.unflatten(s, t);
        let (s_back, t_back) = flattening.flatten(&Taps::SINGLE, u, v);
        assert!((s - s_back).abs() < F32 && (t - t_back).abs() < F32, "{s} {t} became {s_back} {t_back}");
    }
}

#[test]
fn is_black_below_and_continuous() {
    for name in ["synthetic-isotropic", "synthetic-half-turn", "synthetic-both-axes"] {
        black_below(&named(name));
        assert_eq!(named(name).is_isotropic(), name == "synthetic-isotropic");
    }
    // Only tables that are themselves periodic are continuous at the seam: make the last row the first.
    let mut fields = synthetic(&[0.0], 1);
    for (name, shape, data) in &mut fields {
        if let Data::F32(values) = data
            && ["ndf", "vndf", "rgb"].contains(name)
        {
            let (height, width) = (shape[shape.len() - 2], shape[shape.len() - 1]);
            for slice in values.chunks_exact_mut(height * width) {
                slice.copy_within(..width, (height - 1) * width);
            }
        }
    }
    continuous_over_the_wrap(&Rgl::parse(&tensor_file(&fields), "periodic").unwrap());
}

/// The error for the synthetic file after `change`.
fn error_after(change: impl Fn(&mut Vec<Field>)) -> String {
    let mut fields = synthetic(&[0.0], 1);
    change(&mut fields);
    Rgl::parse(&tensor_file(&fields), "changed.bsdf").unwrap_err().to_string()
}

/// Overwrites value `i` of a field of f32.
fn set(name: &'static str, i: usize, value: f32) -> impl Fn(&mut Vec<Field>) {
    move |fields| {
        for field in fields.iter_mut() {
            if let (found, _, Data::F32(values)) = field
                && *found == name
            {
                values[i] = value;
            }
        }
    }
}

#[test]
fn damage_is_named() {
    let cases: [(&str, String); 9] = [
        ("field `rgb`", error_after(|f| f.retain(|field| field.0 != "rgb"))),
        ("field `rgb`", error_after(set("rgb", 5, f32::NAN))),
        ("field `sigma`, value 3", error_after(set("sigma", 3, -1.0))),
        ("ascending", error_after(set("theta_i", 1, 0.0))),
        ("zeros only", error_after(|f| f[6].2 = Data::F32(vec![0.0; 3 * 42]))),
        ("starts with [1, 3]", error_after(|f| f[6] = pattern("vndf", &[1, 2, 7, 6], 41, 4))),
        ("at least 2 x 2", error_after(|f| f[4] = pattern("ndf", &[1, 5], 37, 8))),
        ("it twice", error_after(|f| f.push(pattern("ndf", &[3, 5], 37, 8)))),
        ("90, 180 or 360", {
            let file = tensor_file(&synthetic(&[0.0, 1.0, 2.0], 1));
            Rgl::parse(&file, "changed.bsdf").unwrap_err().to_string()
        }),
    ];
    for (part, error) in cases {
        assert!(error.contains(part) && error.contains("changed.bsdf"), "`{error}` should name {part}");
    }
}

#[test]
fn spectral_files_are_sent_back() {
    let error = error_after(|f| f[8].0 = "spectra");
    assert!(error.contains("_rgb.bsdf"), "{error}");
}

#[test]
fn absurd_sizes_are_errors_and_cost_nothing() {
    let mut file = tensor_file(&synthetic(&[0.0], 1));
    let count = file.clone();
    file[14..18].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(Rgl::parse(&file, "count").unwrap_err().to_string().contains("field count"));
    // The length of `description` lies behind its name, dimension count, type and offset.
    let mut file = count;
    file[18 + 2 + 11 + 11..][..8].copy_from_slice(&(u64::MAX / 2).to_le_bytes());
    assert!(Rgl::parse(&file, "length").unwrap_err().to_string().contains("field `description`"));
}

/// Parses, and evaluates what could be parsed.
fn survives(bytes: &[u8]) -> Result<(), TestCaseError> {
    if let Ok(rgl) = Rgl::parse(bytes, "mutated") {
        for (theta_i, theta_o) in [(0.0, 0.0), (0.3, 1.2), (1.5, 0.01), (1.57, 1.57)] {
            let f = rgl.eval(&Direction::from_angles(theta_i, 0.3), &Direction::from_angles(theta_o, -2.0));
            prop_assert!(f.iter().all(|f| f.is_finite() && *f >= 0.0), "{f:?}");
        }
    }
    Ok(())
}

proptest! {
    #[test]
    fn mutated_files_never_panic(
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        in_header in any::<bool>(),
    ) {
        let mut file = tensor_file(&synthetic(&[-1.0, 2.0], 1));
        let range = if in_header { 420 } else { file.len() };
        changes.iter().for_each(|(at, value)| file[at.index(range)] = *value);
        survives(&file)?;
    }

    #[test]
    fn cut_files_are_errors(length in any::<prop::sample::Index>()) {
        let file = tensor_file(&synthetic(&[0.0], 1));
        prop_assert!(Rgl::parse(&file[..length.index(file.len())], "cut").is_err());
    }

    #[test]
    fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..512)) {
        survives(&bytes)?;
        survives(&[b"tensor_file\0\x01\x00\x01\x00\x00\x00", bytes.as_slice()].concat())?;
    }
}
