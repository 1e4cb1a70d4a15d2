//! Places on the earth as metres east, north and up of one of them.

/// Semi-major axis (m) and flattening of the ellipsoid of WGS 84.
const AXIS: f64 = 6_378_137.0;
const FLATTENING: f64 = 1.0 / 298.257_223_563;

/// The tangent plane at a place of the ellipsoid.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    origin: [f64; 3],
    latitude: f64,
    longitude: f64,
}

impl Frame {
    /// The frame at a latitude and longitude (degrees).
    pub fn new([latitude, longitude]: [f64; 2]) -> Self {
        let (latitude, longitude) = (latitude.to_radians(), longitude.to_radians());
        Self { origin: geocentric(latitude, longitude), latitude, longitude }
    }

    /// East, north and up (m) of a place on the ellipsoid (degrees). The earth's curve makes up negative, by 2 m at 5 km.
    pub fn local(&self, [latitude, longitude]: [f64; 2]) -> [f64; 3] {
        let place = geocentric(latitude.to_radians(), longitude.to_radians());
        let [x, y, z] = [0, 1, 2].map(|k| place[k] - self.origin[k]);
        let ((sin_latitude, cos_latitude), (sin_longitude, cos_longitude)) =
            (self.latitude.sin_cos(), self.longitude.sin_cos());
        let outward = cos_longitude * x + sin_longitude * y;
        [
            cos_longitude * y - sin_longitude * x,
            cos_latitude * z - sin_latitude * outward,
            sin_latitude * z + cos_latitude * outward,
        ]
    }
}

fn geocentric(latitude: f64, longitude: f64) -> [f64; 3] {
    let squashed = (1.0 - FLATTENING) * (1.0 - FLATTENING);
    let (sine, cosine) = latitude.sin_cos();
    let normal = AXIS / (cosine * cosine + squashed * sine * sine).sqrt();
    let (east, ahead) = longitude.sin_cos();
    [normal * cosine * ahead, normal * cosine * east, squashed * normal * sine]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_angles_are_arcs_of_the_meridian_and_the_parallel() {
        // Lengths of a minute of latitude and longitude at 45 degrees north, from tables of WGS 84.
        let frame = Frame::new([45.0, 10.0]);
        let [east, north, up] = frame.local([45.0 + 1.0 / 60.0, 10.0]);
        assert!(east.abs() < 1e-6 && (north - 111_132.0 / 60.0).abs() < 0.3 && up < 0.0, "{north} {up}");
        let [east, north, up] = frame.local([45.0, 10.0 - 1.0 / 60.0]);
        assert!((east + 78_847.0 / 60.0).abs() < 0.3 && north.abs() < 0.2 && up < 0.0, "{east} {north}");
        assert_eq!(frame.local([45.0, 10.0]), [0.0; 3]);
    }

    #[test]
    fn longitudes_wrap() {
        let [east, ..] = Frame::new([-5.0, 179.999]).local([-5.0, -179.999]);
        assert!((east - 221.8).abs() < 0.2, "{east}");
    }
}
