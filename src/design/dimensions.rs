//! The numbers of a rig that a search changes, and those that follow from them.

use crate::optics::{Alignment, Conic, Mirrors, Parameter, Rig};

/// How far a trimmed convex mirror reaches beyond the ray to the dome's end, mm: what decentres of mirrors take away.
const EDGE_MARGIN_MM: f64 = 0.5;

/// Dimensions of a rig: mm and degrees, as in its file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dimensions {
    /// Height of the centre of projection.
    pub centre_height_mm: f64,
    /// The convex mirror.
    pub convex: Conic,
    /// Radius it is trimmed to; infinite where it is not.
    pub edge_radius_mm: f64,
    /// Radius of the dome's rim in the sample's plane.
    pub rim_radius_mm: f64,
    /// Where the dome ends.
    pub dome_end_deg: f64,
    /// Smallest and largest polar angle of the zone.
    pub zone_deg: [f64; 2],
    /// Radius and height of the dome's opening.
    pub opening_mm: [f64; 2],
    /// The camera's lens.
    pub camera: Optics,
    /// The projector's lens.
    pub projector: Optics,
}

/// A thin lens with a sensor or panel behind it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optics {
    /// Focal length.
    pub focal_length_mm: f64,
    /// Distance it is focused at.
    pub focus_mm: f64,
    /// Radius of its pupil.
    pub pupil_mm: f64,
    /// Pixel pitch.
    pub pitch_mm: f64,
    /// Half of the shorter side.
    pub half_side_px: f64,
}

impl Optics {
    /// Image distance in pixels.
    pub fn focal_px(&self) -> f64 {
        1.0 / ((1.0 / self.focal_length_mm - 1.0 / self.focus_mm) * self.pitch_mm)
    }
}

impl Dimensions {
    /// Those of a rig as it is.
    pub fn of(rig: &Rig) -> Self {
        let (p, c, j) = (&rig.paraboloid, &rig.camera, &rig.projector);
        Self {
            centre_height_mm: rig.centre_height_mm,
            convex: Conic { vertex_height: p.vertex_height_mm, radius: 2.0 * p.focal_length_mm, constant: p.conic },
            edge_radius_mm: rig.paraboloid_radius_mm(),
            rim_radius_mm: rig.dome.rim_radius_mm,
            dome_end_deg: rig.dome.theta_max_deg,
            zone_deg: [rig.zone.theta_min_deg, rig.zone.theta_max_deg],
            opening_mm: [rig.alignment.opening_radius_mm, rig.alignment.wire_height_mm],
            camera: Optics {
                focal_length_mm: c.focal_length_mm,
                focus_mm: c.focus_mm,
                pupil_mm: c.pupil_mm(),
                pitch_mm: c.pitch_um * 1e-3,
                half_side_px: c.width_px.min(c.height_px) as f64 / 2.0,
            },
            projector: Optics {
                focal_length_mm: j.focal_length_mm,
                focus_mm: j.focus_mm,
                pupil_mm: j.pupil_mm(),
                pitch_mm: j.pitch_um * 1e-3,
                half_side_px: j.width_px.min(j.height_px) as f64 / 2.0,
            },
        }
    }

    /// Changes one of them, and with it what [`Parameter`] says moves along.
    pub fn set(&mut self, parameter: Parameter, value: f64) {
        let refocus = |d: &mut Self, farther: f64| {
            d.camera.focus_mm += farther;
            d.projector.focus_mm += farther;
        };
        match parameter {
            Parameter::CentreHeight => {
                let farther = value - self.centre_height_mm;
                refocus(self, farther);
                self.centre_height_mm = value;
            }
            Parameter::VertexHeight => {
                let farther = self.convex.vertex_height - value;
                refocus(self, farther);
                self.convex.vertex_height = value;
            }
            Parameter::ConvexFocalLength => self.convex.radius = 2.0 * value,
            Parameter::Conic => self.convex.constant = value,
            Parameter::RimRadius => self.rim_radius_mm = value,
            Parameter::ZoneEnd => {
                self.dome_end_deg += value - self.zone_deg[1];
                self.zone_deg[1] = value;
            }
            Parameter::CameraFocalLength => self.camera.focal_length_mm = value,
            Parameter::ProjectorFocalLength => self.projector.focal_length_mm = value,
        }
    }

    /// The mirrors; `None` if no ray reaches the rim.
    pub fn mirrors(&self) -> Option<Mirrors> {
        Mirrors::new(self.centre_height_mm, self.convex, self.rim_radius_mm)
    }

    /// Radius on the convex mirror that shows the polar angle `theta`, radians, to 1e-10 mm; `None` beyond what it shows.
    ///
    /// A chord that keeps both signs (Illinois method), some eight points of the profile where halving takes sixty.
    pub(super) fn radius_of(&self, mirrors: &Mirrors, theta: f64) -> Option<f64> {
        let excess = |rho: f64| mirrors.profile(rho).map(|p| p.x.atan2(p.z) - theta);
        let (mut a, mut b) = (0.0, mirrors.edge_radius());
        let (mut at_a, mut at_b) = (-theta, excess(b)?);
        if at_b.abs() < 1e-9 {
            return Some(b);
        }
        if at_b < 0.0 {
            return None;
        }
        for _ in 0..60 {
            let c = (a * at_b - b * at_a) / (at_b - at_a);
            let at_c = excess(c)?;
            if at_c * at_b < 0.0 {
                (a, at_a) = (b, at_b);
            } else {
                at_a *= 0.5;
            }
            (b, at_b) = (c, at_c);
            if (b - a).abs() < 1e-10 || at_b.abs() < 1e-13 {
                break;
            }
        }
        Some(b)
    }

    /// The same with all that follows: the convex mirror trimmed to what the dome's end needs, the zone from where neither the
    /// mirror's shadow nor the dome's opening reaches the camera's footprint, the opening as large as the beams.
    ///
    /// `None` if the mirrors do not show the dome's end.
    pub fn trimmed(mut self, mirrors: &Mirrors) -> Option<Self> {
        let last = self.radius_of(mirrors, self.dome_end_deg.to_radians())?;
        let widest = self.camera.pupil_mm.max(self.projector.pupil_mm);
        let height = mirrors.convex().height(last);
        let distance = self.centre_height_mm - height;
        let blur = [&self.camera, &self.projector].map(|d| d.pupil_mm * (distance / d.focus_mm - 1.0).abs());
        let edge = (last + EDGE_MARGIN_MM + blur[0].max(blur[1])).min(mirrors.edge_radius());
        let edge_height = mirrors.convex().height(edge);
        let top = mirrors.profile(1e-3 * last)?.z;
        let share = (self.centre_height_mm - top) / (self.centre_height_mm - edge_height);
        let opening = edge * share + widest * (1.0 - share);
        let spot =
            self.camera.pupil_mm * super::chief::Chief::new(mirrors, last)?.footprint.into_iter().fold(0.0, f64::max);
        let start = (edge + spot).atan2(edge_height).max((opening + spot).atan2(top));
        self.edge_radius_mm = edge;
        self.opening_mm = [opening, top];
        self.zone_deg[0] = start.to_degrees();
        Some(self)
    }

    /// A rig of these dimensions whose other properties are those of `base`, without its search table. Numbers are rounded to
    /// what a workshop would be told: 0.01 mm, 0.0001 of the conic constant, and 0.1 deg towards a smaller zone.
    pub fn to_rig(&self, base: &Rig) -> Rig {
        let round = |x: f64, steps: f64| (x * steps).round() / steps;
        let mut rig = base.clone();
        rig.search = None;
        rig.centre_height_mm = round(self.centre_height_mm, 100.0);
        rig.paraboloid.focal_length_mm = round(0.5 * self.convex.radius, 100.0);
        rig.paraboloid.vertex_height_mm = round(self.convex.vertex_height, 100.0);
        rig.paraboloid.conic = round(self.convex.constant, 1e4);
        rig.paraboloid.edge_radius_mm = Some((self.edge_radius_mm * 100.0).ceil() / 100.0);
        rig.dome.rim_radius_mm = round(self.rim_radius_mm, 100.0);
        rig.zone.theta_max_deg = (self.zone_deg[1] * 10.0).floor() / 10.0;
        rig.dome.theta_max_deg = round(rig.zone.theta_max_deg + self.dome_end_deg - self.zone_deg[1], 10.0);
        rig.zone.theta_min_deg = ((self.zone_deg[0] + 5e-3) * 10.0).ceil() / 10.0;
        let devices = [
            (&self.camera, &mut rig.camera.focal_length_mm, &mut rig.camera.focus_mm, &mut rig.camera.f_number),
            (
                &self.projector,
                &mut rig.projector.focal_length_mm,
                &mut rig.projector.focus_mm,
                &mut rig.projector.f_number,
            ),
        ];
        for (optics, focal_length_mm, focus_mm, f_number) in devices {
            *focal_length_mm = round(optics.focal_length_mm, 100.0);
            *focus_mm = round(optics.focus_mm, 100.0);
            *f_number = round(*focal_length_mm / (2.0 * optics.pupil_mm), 1e4);
        }
        let [radius, top] = self.opening_mm;
        rig.alignment = Alignment {
            wire_height_mm: round(top, 10.0),
            opening_radius_mm: (radius * 10.0).ceil() / 10.0,
            ..rig.alignment
        };
        rig
    }
}
