//! The front of a search for better dimensions: table and picture.

use super::axis::Axis;
use super::chart::{Chart, Mark, Series};
use super::sheet::Sheet;
use crate::design::{Design, Found, Search, Values};
use crate::optics::Objective;

/// The front as CSV: objectives and dimensions of each rig, mm and degrees; the rig searched from has the number 0.
pub fn front_csv(search: &Search, found: &Found) -> Vec<u8> {
    let dimensions = "centre_height_mm,paraboloid_focal_length_mm,paraboloid_vertex_height_mm,paraboloid_conic,\
                      paraboloid_edge_radius_mm,dome_rim_radius_mm,dome_theta_max_deg,camera_focal_length_mm,\
                      projector_focal_length_mm";
    let keys: Vec<_> = Objective::ALL.iter().map(|o| o.key()).collect();
    let mut csv = format!("rig,theta_min_deg,theta_max_deg,{},{dimensions},binding\n", keys.join(","));
    let mut row = |number: usize, values: &Values, d: &crate::design::Dimensions, binding: &[&str]| {
        let own = [values.theta_min_deg, values.theta_max_deg];
        let objectives = Objective::ALL.iter().map(|o| values.get(*o));
        let dimensions = [
            d.centre_height_mm,
            0.5 * d.convex.radius,
            d.convex.vertex_height,
            d.convex.constant,
            d.edge_radius_mm,
            d.rim_radius_mm,
            d.dome_end_deg,
            d.camera.focal_length_mm,
            d.projector.focal_length_mm,
        ];
        let numbers: Vec<String> =
            own.into_iter().chain(objectives).chain(dimensions).map(|x| format!("{x:.5}")).collect();
        csv += &format!("{number},{},{}\n", numbers.join(","), binding.join(" "));
    };
    row(0, search.own(), search.base(), &[]);
    for (i, design) in found.front.iter().enumerate() {
        row(i + 1, &design.values, &design.dimensions, &design.binding);
    }
    csv.into_bytes()
}

/// The front as pictures: each other objective over the first.
pub fn front_sheet(search: &Search, found: &Found) -> Sheet {
    let objectives = search.objectives();
    let panel = |y: &Objective| {
        let at = |v: &Values| (v.get(objectives[0]), v.get(*y));
        let front = found.front.iter().map(|d: &Design| at(&d.values)).collect();
        let mut series =
            vec![Series::new(FRONT, front, Mark::Points, 1), Series::new(OWN, vec![at(search.own())], Mark::Points, 0)];
        if let Some(balanced) = &found.balanced {
            series.push(Series::new(BALANCED, vec![at(&balanced.values)], Mark::Points, 2));
        }
        let title = format!("{} over {}", y.key(), objectives[0].key());
        let chart = Chart::new(title, Axis::linear(objectives[0].key()), Axis::linear(y.key()), series);
        Some((y.key().to_owned(), chart))
    };
    // The legend's place.
    let panels = objectives[1..].iter().map(panel).chain([None]).collect();
    Sheet {
        title: "Rigs that none other found beats".into(),
        columns: 2,
        panels,
        series: [(1, FRONT), (0, OWN), (2, BALANCED)].map(|(style, name)| (style, Mark::Points, name.into())).into(),
        notes: Vec::new(),
    }
}

const FRONT: &str = "front";
const OWN: &str = "rig searched from";
const BALANCED: &str = "balanced: better in all alike";
