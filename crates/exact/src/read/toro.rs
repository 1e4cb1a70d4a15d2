//! TORO files: `VERTEX2 id x y theta`, `EDGE2 i j dx dy dtheta I11 I12 I22 I33 I13 I23`, and `VERTEX3`, `EDGE3` with roll,
//! pitch, yaw and the upper triangle of the information; `EQUIV` lines are passed over.

use super::fields::{PLANE, lines};
use super::g2o::vertex;
use super::{FileFactor, FileVariable, GraphFile, Measurement};
use crate::ExactError;
use sumprod_graph::Space;

const ANGLES: [&str; 6] = ["x", "y", "z", "roll", "pitch", "yaw"];

pub(super) fn read(file: &mut GraphFile, text: &str) -> Result<(), ExactError> {
    let path = file.path.clone();
    let given = lines(&path, text).any(|fields| fields.tag.starts_with("VERTEX"));
    for mut fields in lines(&path, text).filter(|fields| matches!(fields.tag, "VERTEX2" | "VERTEX3")) {
        let name = fields.word("the vertex's number")?.to_owned();
        let (space, value) = match fields.tag {
            "VERTEX2" => (Space::Se2, fields.numbers(&PLANE)?),
            _ => (Space::Se3, quaternion(&fields.numbers(&ANGLES)?)),
        };
        fields.end()?;
        file.add_variable(Some(fields.line), FileVariable { name, space, value: Some(value) })?;
    }
    for mut fields in lines(&path, text) {
        let space = match fields.tag {
            "EDGE2" => Space::Se2,
            "EDGE3" => Space::Se3,
            "VERTEX2" | "VERTEX3" | "EQUIV" => continue,
            tag => {
                let known = "VERTEX2, EDGE2, VERTEX3, EDGE3, EQUIV";
                return Err(
                    fields.error(format!("{tag:?} is no element of TORO that is known here: {known}"))
                );
            }
        };
        let mut variables = Vec::with_capacity(2);
        for _ in 0..2 {
            let name = fields.word("a vertex's number")?;
            variables.push(vertex(file, &fields, name, space.clone(), given)?);
        }
        let (measured, information) = if space == Space::Se2 {
            let measured = fields.numbers(&PLANE)?;
            let [a, b, c, d, e, f] = [(); 6].map(|()| fields.number("an entry of the information matrix"));
            let (xx, xy, yy, tt, xt, yt) = (a?, b?, c?, d?, e?, f?);
            (measured, vec![xx, xy, xt, xy, yy, yt, xt, yt, tt])
        } else {
            let measured = quaternion(&fields.numbers(&ANGLES)?);
            (measured, fields.triangle(6, "an entry of the information matrix")?)
        };
        fields.end()?;
        let covariance = fields.inverted(&information, space.degrees_of_freedom())?;
        let measurement = Measurement::RelativePose(measured);
        file.factors.push(FileFactor { line: Some(fields.line), variables, measurement, covariance });
    }
    Ok(())
}

/// Position and quaternion of a position with roll, pitch and yaw: R = Rz(yaw) Ry(pitch) Rx(roll).
fn quaternion(pose: &[f64]) -> Vec<f64> {
    let [(sr, cr), (sp, cp), (sy, cy)] = [pose[3], pose[4], pose[5]].map(|angle| (0.5 * angle).sin_cos());
    vec![
        pose[0],
        pose[1],
        pose[2],
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    ]
}
