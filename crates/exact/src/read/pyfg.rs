//! PyFG files: elements in any order, poses with a time, variables by name, covariances.

use super::fields::{Fields, PLANE, SPACE, lines};
use super::{FileFactor, FileVariable, GraphFile, Measurement};
use crate::ExactError;
use sumprod_graph::Space;

pub(super) fn read(file: &mut GraphFile, text: &str) -> Result<(), ExactError> {
    let path = file.path.clone();
    let is_variable = |tag: &str| tag.starts_with("VERTEX") && !tag.ends_with(":PRIOR");
    for mut fields in lines(&path, text).filter(|fields| is_variable(fields.tag)) {
        let (space, names): (Space, &[&str]) = match fields.tag {
            "VERTEX_SE2" => (Space::Se2, &PLANE),
            "VERTEX_SE3:QUAT" => (Space::Se3, &SPACE),
            "VERTEX_XY" => (Space::real(2), &PLANE[..2]),
            "VERTEX_XYZ" => (Space::real(3), &SPACE[..3]),
            _ => return Err(unknown(&fields)),
        };
        if matches!(space, Space::Se2 | Space::Se3) {
            fields.number("the time")?;
        }
        let name = fields.word("the variable's name")?.to_owned();
        let value = Some(fields.numbers(names)?);
        fields.end()?;
        file.add_variable(Some(fields.line), FileVariable { name, space, value })?;
    }
    for mut fields in lines(&path, text).filter(|fields| !is_variable(fields.tag)) {
        fields.number("the time")?;
        let factor = match fields.tag {
            "EDGE_RANGE" => range(file, &mut fields)?,
            tag if tag.ends_with(":PRIOR") => prior(file, &mut fields)?,
            _ => relative(file, &mut fields)?,
        };
        fields.end()?;
        file.factors.push(factor);
    }
    Ok(())
}

fn variable(file: &GraphFile, fields: &mut Fields<'_>) -> Result<usize, ExactError> {
    let name = fields.word("a variable's name")?;
    fields.known(file, name)
}

fn expect(file: &GraphFile, fields: &Fields<'_>, number: usize, space: &Space) -> Result<(), ExactError> {
    let found = &file.variables[number];
    if found.space == *space {
        return Ok(());
    }
    let (name, tag) = (&found.name, fields.tag);
    Err(fields.error(format!("{tag} needs {name} to be of {space:?}, but it is of {:?}", found.space)))
}

fn range(file: &GraphFile, fields: &mut Fields<'_>) -> Result<FileFactor, ExactError> {
    let variables = vec![variable(file, fields)?, variable(file, fields)?];
    if variables[0] == variables[1] {
        return Err(
            fields.error(format!("{} joins {} to itself", fields.tag, file.variables[variables[0]].name))
        );
    }
    let flat = |&v: &usize| {
        matches!(file.variables[v].space, Space::Se3) || file.variables[v].space == Space::real(3)
    };
    if variables.iter().any(flat) != variables.iter().all(flat) {
        return Err(fields.error("EDGE_RANGE joins a variable of the plane to one of space"));
    }
    let measured = fields.number("the range")?;
    let variance = fields.number("the variance")?;
    if measured < 0.0 {
        return Err(fields.error(format!("the range is {measured} m; it cannot be negative")));
    }
    if variance <= 0.0 {
        return Err(fields.error(format!("the variance of the range is {variance}; it must be positive")));
    }
    let measurement = Measurement::Range(measured);
    Ok(FileFactor { line: Some(fields.line), variables, measurement, covariance: vec![variance] })
}

fn prior(file: &GraphFile, fields: &mut Fields<'_>) -> Result<FileFactor, ExactError> {
    let number = variable(file, fields)?;
    let (space, names): (Space, &[&str]) = match fields.tag {
        "VERTEX_SE2:PRIOR" => (Space::Se2, &PLANE),
        "VERTEX_SE3:QUAT:PRIOR" => (Space::Se3, &SPACE),
        "VERTEX_XY:PRIOR" => (Space::real(2), &PLANE[..2]),
        "VERTEX_XYZ:PRIOR" => (Space::real(3), &SPACE[..3]),
        _ => return Err(unknown(fields)),
    };
    expect(file, fields, number, &space)?;
    let mean = fields.numbers(names)?;
    let covariance = fields.triangle(space.degrees_of_freedom(), "an entry of the covariance")?;
    let measurement = Measurement::Prior(mean);
    Ok(FileFactor { line: Some(fields.line), variables: vec![number], measurement, covariance })
}

fn relative(file: &GraphFile, fields: &mut Fields<'_>) -> Result<FileFactor, ExactError> {
    let (spaces, names): ([Space; 2], &[&str]) = match fields.tag {
        "EDGE_SE2" => ([Space::Se2, Space::Se2], &PLANE),
        "EDGE_SE3:QUAT" => ([Space::Se3, Space::Se3], &SPACE),
        "EDGE_SE2_XY" => ([Space::Se2, Space::real(2)], &PLANE[..2]),
        "EDGE_SE3_XYZ" => ([Space::Se3, Space::real(3)], &SPACE[..3]),
        _ => return Err(unknown(fields)),
    };
    let variables = vec![variable(file, fields)?, variable(file, fields)?];
    for (&number, space) in variables.iter().zip(&spaces) {
        expect(file, fields, number, space)?;
    }
    let measured = fields.numbers(names)?;
    let size = spaces[1].degrees_of_freedom();
    let covariance = fields.triangle(size, "an entry of the covariance")?;
    let poses = matches!(spaces[1], Space::Se2 | Space::Se3);
    let measurement = if poses { Measurement::RelativePose(measured) } else { Measurement::Point(measured) };
    Ok(FileFactor { line: Some(fields.line), variables, measurement, covariance })
}

fn unknown(fields: &Fields<'_>) -> ExactError {
    fields.error(format!(
        "{:?} is no element of PyFG: VERTEX_SE2, VERTEX_SE3:QUAT, VERTEX_XY, VERTEX_XYZ, the same with :PRIOR, EDGE_SE2, \
         EDGE_SE3:QUAT, EDGE_SE2_XY, EDGE_SE3_XYZ, EDGE_RANGE",
        fields.tag
    ))
}
