//! Responses of real devices: a film camera's from its bracket, a projector's from measured levels.
#![cfg(feature = "corpus")]

use std::path::PathBuf;

use serde::Deserialize;
use zonal::radiometry::{CameraResponse, Response, Stack};

fn corpus() -> PathBuf {
    std::env::var_os("ZONAL_CORPUS")
        .expect("feature `corpus` needs ZONAL_CORPUS, the folder of the measured data")
        .into()
}

/// Ratio of light between neighbouring images of the bracket.
const TRUE_RATIO: f64 = 2.0;
/// The shutter's own error, and what moved in the church: of red and green, and of the median of the three colours.
const RATIO: f64 = 0.08;
/// Blue of the windows grows by 2.2 to 2.4 from image to image where red and green double: scans of film mix colours, which no
/// response of one channel describes (OpenCV's curves say the same).
const BLUE: f64 = 0.22;
/// Above the code that film and scanner give in darkness: below, grain and stray light hide what the light adds.
const ABOVE_BLACK: u8 = 15;
/// Below what they clip.
const WHITE: u8 = 235;
/// Every so many pixels enter a curve.
const STRIDE: usize = 37;

/// Exposures from 32 s down and the images without their frame, by channel.
fn memorial() -> (Vec<f64>, Vec<[Vec<u8>; 3]>) {
    let folder = corpus().join("brackets");
    let times = std::fs::read_to_string(folder.join("shutter_times.txt")).unwrap();
    let seconds = |line: &str| match line.split_once('/') {
        Some((a, b)) => a.parse::<f64>().unwrap() / b.parse::<f64>().unwrap(),
        None => line.parse().unwrap(),
    };
    let images = (61..=76).map(|n| {
        let image = image::open(folder.join(format!("memorial00{n}.png"))).unwrap().to_rgb8();
        let crop: Vec<_> = (40..730).flat_map(|row| (30..480).map(move |column| (column, row))).collect();
        [0, 1, 2].map(|c| crop.iter().map(|&(column, row)| image.get_pixel(column, row).0[c]).collect())
    });
    (times.split_whitespace().map(seconds).collect(), images.collect())
}

/// The shortest exposures hardly have a usable pixel. They stay in the stack, where what is clipped has no weight, and a pair
/// that shares too few pixels has no ratio: the last one, 1/512 to 1/1024 s.
#[test]
fn a_church_is_taken_with_steps_of_two() {
    let (times, images) = memorial();
    assert_eq!((times.len(), images.len()), (16, 16));
    let mut by_channel = [Vec::new(), Vec::new()];
    for (c, tolerance) in [RATIO, RATIO, BLUE].into_iter().enumerate() {
        let some: Vec<Vec<u8>> = images.iter().map(|i| i[c].iter().copied().step_by(STRIDE).collect()).collect();
        let some: Vec<&[u8]> = some.iter().map(Vec::as_slice).collect();
        // Most of the shortest exposure is black.
        let mut darkest = images[15][c].clone();
        darkest.sort_unstable();
        let usable = darkest[darkest.len() / 2] + ABOVE_BLACK..=WHITE;
        let stack = Stack::new(&some, &times, usable.clone()).unwrap();
        let curves = [CameraResponse::debevec(&stack, 10.0).unwrap(), CameraResponse::robertson(&stack).unwrap()];
        for (curve, by_channel) in curves.into_iter().zip(&mut by_channel) {
            assert!(curve.exposures().windows(2).all(|e| e[0] <= e[1]));
            let ratios: Vec<Option<f64>> =
                images.windows(2).map(|i| curve.exposure_ratio(&i[1][c], &i[0][c], usable.clone())).collect();
            println!("{usable:?} {ratios:.3?}");
            let known: Vec<f64> = ratios.into_iter().map_while(|r| r).collect();
            assert_eq!(known.len(), 14, "pairs with enough pixels");
            assert!(known.iter().all(|r| (r / TRUE_RATIO - 1.0).abs() < tolerance), "{known:?}");
            by_channel.push(known);
        }
    }
    for by_channel in by_channel {
        let [red, green, blue] = &by_channel[..] else { panic!("three colours") };
        for ((r, g), b) in red.iter().zip(green).zip(blue) {
            let mut three = [*r, *g, *b];
            three.sort_by(f64::total_cmp);
            assert!((three[1] / TRUE_RATIO - 1.0).abs() < RATIO, "{three:?}");
        }
    }
}

#[derive(Deserialize)]
struct Measured {
    ids: Vec<u8>,
    ambient: Vec<f64>,
    signal: Vec<f64>,
}

/// Of white, at points the curve has not seen: |level(code(x)) - x| of all, and |level(code) - x| of all but two.
const INVERSION: f64 = 0.005;
/// The measured light itself jumps between codes 215 and 220, and from 250 to 255: no smooth curve foresees that.
const JUMP: f64 = 0.015;

#[test]
fn projector_responses_invert_to_half_a_percent_of_white() {
    for channel in ["gray", "red", "green", "blue"] {
        let text = std::fs::read_to_string(corpus().join(format!("projector/{channel}.json"))).unwrap();
        let measured: Measured = serde_json::from_str(&text).unwrap();
        let light = measured.signal.iter().zip(&measured.ambient).map(|(s, a)| s - a);
        let points: Vec<(u8, f64)> = measured.ids.into_iter().zip(light).collect();
        assert_eq!(points.len(), 52);
        let (black, white) = (points[0].1, points[51].1);
        // Both ends belong to every curve: they are its gauge.
        let fitted: Vec<_> =
            points.iter().copied().enumerate().filter(|(i, _)| i % 2 == 0 || *i == 51).map(|p| p.1).collect();
        let response = Response::from_points(&fitted).unwrap();
        let held_out = points.iter().skip(1).step_by(2).filter(|p| p.0 < 255);
        let (mut forward, mut inverse) = (Vec::new(), 0.0f64);
        for (code, light) in held_out {
            let x = (light - black) / (white - black);
            forward.push((response.level(*code) - x).abs());
            inverse = inverse.max((response.level(response.code(x)) - x).abs());
        }
        forward.sort_by(f64::total_cmp);
        let (most, worst) = (forward[forward.len() - 3], forward[forward.len() - 1]);
        println!(
            "{channel}: inversion off by {inverse:.4} of white, curve by {most:.4}, at jumps of the data {worst:.4}"
        );
        assert!(inverse <= INVERSION && most <= INVERSION && worst <= JUMP, "{channel}: {inverse} {most} {worst}");
    }
}
