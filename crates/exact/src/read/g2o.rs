//! g2o files: `VERTEX_SE2 id x y theta`, `EDGE_SE2 i j dx dy dtheta I11 I12 I13 I22 I23 I33`, the same in space with a
//! quaternion and 21 numbers of information, points and `FIX id`.

use super::fields::{Fields, PLANE, SPACE, lines};
use super::{FileFactor, FileVariable, GraphFile, Measurement};
use crate::ExactError;
use sumprod_graph::Space;

/// The standard deviation of a vertex that the file fixes (m, rad).
const FIXED: f64 = 1e-4;

pub(super) fn read(file: &mut GraphFile, text: &str) -> Result<(), ExactError> {
    let path = file.path.clone();
    let given = lines(&path, text).any(|fields| fields.tag.starts_with("VERTEX"));
    for mut fields in lines(&path, text).filter(|fields| fields.tag.starts_with("VERTEX")) {
        let (space, names): (Space, &[&str]) = match fields.tag {
            "VERTEX_SE2" => (Space::Se2, &PLANE),
            "VERTEX_SE3:QUAT" => (Space::Se3, &SPACE),
            "VERTEX_XY" => (Space::real(2), &PLANE[..2]),
            "VERTEX_TRACKXYZ" | "VERTEX_XYZ" => (Space::real(3), &SPACE[..3]),
            _ => return Err(unknown(&fields)),
        };
        let name = fields.word("the vertex's number")?.to_owned();
        let value = Some(fields.numbers(names)?);
        fields.end()?;
        file.add_variable(Some(fields.line), FileVariable { name, space, value })?;
    }
    for mut fields in lines(&path, text).filter(|fields| !fields.tag.starts_with("VERTEX")) {
        let (measured, freedoms): (&[&str], usize) = match fields.tag {
            "EDGE_SE2" => (&PLANE, 3),
            "EDGE_SE3:QUAT" => (&SPACE, 6),
            "EDGE_SE2_XY" => (&PLANE[..2], 2),
            "EDGE_SE3_TRACKXYZ" | "EDGE_SE3_XYZ" => (&SPACE[..3], 3),
            "FIX" => {
                fix(file, &mut fields)?;
                continue;
            }
            "PARAMS_SE3OFFSET" => continue,
            _ => return Err(unknown(&fields)),
        };
        let poses = matches!(fields.tag, "EDGE_SE2" | "EDGE_SE3:QUAT");
        let spaces = match fields.tag {
            "EDGE_SE2" => [Space::Se2, Space::Se2],
            "EDGE_SE3:QUAT" => [Space::Se3, Space::Se3],
            "EDGE_SE2_XY" => [Space::Se2, Space::real(2)],
            _ => [Space::Se3, Space::real(3)],
        };
        let mut variables = Vec::with_capacity(2);
        for space in spaces {
            let name = fields.word("a vertex's number")?;
            variables.push(vertex(file, &fields, name, space, given)?);
        }
        let measured = fields.numbers(measured)?;
        let information = fields.triangle(freedoms, "an entry of the information matrix")?;
        fields.end()?;
        let covariance = fields.inverted(&information, freedoms)?;
        let measurement =
            if poses { Measurement::RelativePose(measured) } else { Measurement::Point(measured) };
        file.factors.push(FileFactor { line: Some(fields.line), variables, measurement, covariance });
    }
    Ok(())
}

/// The variable of a vertex; where the file gives no vertices, a new one.
pub(super) fn vertex(
    file: &mut GraphFile,
    fields: &Fields<'_>,
    name: &str,
    space: Space,
    given: bool,
) -> Result<usize, ExactError> {
    let number = match file.find(name) {
        Some(number) => number,
        None if given => fields.known(file, name)?,
        None => {
            let variable = FileVariable { name: name.to_owned(), space: space.clone(), value: None };
            file.add_variable(Some(fields.line), variable)?
        }
    };
    if file.variables[number].space != space {
        let found = &file.variables[number].space;
        return Err(fields.error(format!(
            "{} needs vertex {name} to be of {space:?}, but it is of {found:?}",
            fields.tag
        )));
    }
    Ok(number)
}

fn fix(file: &mut GraphFile, fields: &mut Fields<'_>) -> Result<(), ExactError> {
    let name = fields.word("the fixed vertex's number")?;
    fields.end()?;
    let number = fields.known(file, name)?;
    let variable = &file.variables[number];
    let d = variable.space.degrees_of_freedom();
    let mean = variable.value.clone().unwrap_or_default();
    let mut covariance = vec![0.0; d * d];
    (0..d).for_each(|k| covariance[k * d + k] = FIXED * FIXED);
    file.factors.push(FileFactor {
        line: Some(fields.line),
        variables: vec![number],
        measurement: Measurement::Prior(mean),
        covariance,
    });
    Ok(())
}

fn unknown(fields: &Fields<'_>) -> ExactError {
    fields.error(format!(
        "{:?} is no element of g2o that is known here: VERTEX_SE2, VERTEX_SE3:QUAT, VERTEX_XY, VERTEX_TRACKXYZ, EDGE_SE2, \
         EDGE_SE3:QUAT, EDGE_SE2_XY, EDGE_SE3_TRACKXYZ, FIX",
        fields.tag
    ))
}
