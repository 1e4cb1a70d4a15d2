//! Malformed files: the file and line are named, with what was found and what was expected.

use std::path::Path;
use sumprod_exact::read::GraphFile;
use sumprod_models::library::PoseResidual;

fn said(name: &str, text: &str) -> String {
    match GraphFile::parse(Path::new(name), text).and_then(|file| file.graph(PoseResidual::Log).map(|_| ())) {
        Err(error) => error.to_string(),
        Ok(()) => panic!("read: {text}"),
    }
}

const VERTICES: &str = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n";

#[test]
fn g2o() {
    let cases = [
        (
            "EDGE_SE2 0 1 1 0 0 1 0 0 1 0",
            "a.g2o:3: EDGE_SE2 ends after 10 fields; an entry of the information matrix is missing",
        ),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1 5", "a.g2o:3: EDGE_SE2 has 12 fields, expected 11"),
        ("EDGE_SE2 0 1 1 x 0 1 0 0 1 0 1", "a.g2o:3: field 4 of EDGE_SE2 (y) is \"x\", not a number"),
        ("EDGE_SE2 0 1 1 nan 0 1 0 0 1 0 1", "field 4 of EDGE_SE2 (y) is NaN"),
        ("EDGE_SE2 0 7 1 0 0 1 0 0 1 0 1", "EDGE_SE2 refers to 7, which no VERTEX line gives"),
        (
            "EDGE_SE2 0 1 1 0 0 1 2 0 1 0 1",
            "a.g2o:3: EDGE_SE2: the information matrix is not positive definite",
        ),
        ("EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1", "needs vertex 0 to be of Se3, but it is of Se2"),
        ("EDGE_SE9 0 1", "a.g2o:3: \"EDGE_SE9\" is no element of g2o that is known here"),
        ("VERTEX_SE2 1 0 0 0", "a.g2o:3: variable 1 is given twice"),
        ("FIX 9", "FIX refers to 9"),
        ("", "a.g2o: holds no factor"),
    ];
    for (line, expected) in cases {
        let found = said("a.g2o", &format!("{VERTICES}{line}\n"));
        assert!(found.contains(expected), "{line}: {found}");
    }
    let zero = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 1\n\
                EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 0 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n";
    assert!(said("a.g2o", zero).contains("a.g2o:3: the quaternion"), "{}", said("a.g2o", zero));
    assert!(said("a.g2o", "").contains("is empty"));
    assert!(said("a.g2o", "# nothing\n\nhello world\n").starts_with("a.g2o:3: starts with \"hello\""));
}

#[test]
fn toro() {
    let head = "VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\n";
    for (line, expected) in [
        ("EDGE2 0 1 1 0 0 1 0 1 1 0", "a.graph:3: EDGE2 ends after 10 fields"),
        ("EDGE2 0 1 1 0 0 1 0 1 -1 0 0", "a.graph:3: EDGE2: the information matrix is not positive definite"),
        ("EDGE3 0 1 1 0 0 0 0 0", "needs vertex 0 to be of Se3"),
        ("VERTEX4 0 1", "a.graph:3: \"VERTEX4\" is no element of TORO"),
    ] {
        let found = said("a.graph", &format!("{head}{line}\n"));
        assert!(found.contains(expected), "{line}: {found}");
    }
}

#[test]
fn pyfg() {
    let head = "VERTEX_SE2 0.0 A0 0 0 0\nVERTEX_SE2 1.0 A1 1 0 0\nVERTEX_XY L0 3 4\nVERTEX_XYZ L1 3 4 5\n";
    for (line, expected) in [
        ("EDGE_RANGE 0 A0 L0 5 0", "a.pyfg:5: the variance of the range is 0"),
        ("EDGE_RANGE 0 A0 L0 -5 1", "a.pyfg:5: the range is -5 m"),
        ("EDGE_RANGE 0 A0 A0 5 1", "joins A0 to itself"),
        ("EDGE_RANGE 0 A0 L1 5 1", "joins a variable of the plane to one of space"),
        ("EDGE_RANGE 0 A0 L9 5 1", "refers to L9"),
        ("EDGE_RANGE 0 A0 L0 5", "a.pyfg:5: EDGE_RANGE ends after 4 fields; the variance is missing"),
        ("EDGE_SE2 0 A0 L0 1 0 0 1 0 0 1 0 1", "EDGE_SE2 needs L0 to be of Se2"),
        ("EDGE_SE2 0 A0 A1 1 0 0 1 2 0 1 0 1", "a.pyfg:5: the noise covariance is not positive definite"),
        ("VERTEX_SE2:PRIOR 0 A0 0 0 0 1 0 0 1 0", "an entry of the covariance is missing"),
        ("EDGE_SE2 soon A0 A1 1 0 0 1 0 0 1 0 1", "(the time) is \"soon\", not a number"),
        ("EDGE_BEARING 0 A0 L0 1 1", "is no element of PyFG"),
    ] {
        let found = said("a.pyfg", &format!("{head}{line}\n"));
        assert!(found.contains(expected), "{line}: {found}");
    }
}

#[test]
fn json() {
    let variables = r#""variables": [{"name": "x", "dim": 2}]"#;
    for (factor, expected) in [
        (
            r#"{"variables": ["y"], "A": [[[1, 0]]], "b": [0], "noise_covariance": [[1]]}"#,
            "factors[0]: there is no variable \"y\"",
        ),
        (
            r#"{"variables": ["x"], "A": [[[1]]], "b": [0], "noise_covariance": [[1]]}"#,
            "factors[0]: the matrix of x is not 1 by 2",
        ),
        (
            r#"{"variables": ["x"], "A": [], "b": [0], "noise_covariance": [[1]]}"#,
            "A has 0 matrices for 1 variables",
        ),
        (
            r#"{"variables": ["x"], "A": [[[1, 0]]], "b": [0], "noise_covariance": [[1, 2]]}"#,
            "noise_covariance is not 1 by 1",
        ),
        (
            r#"{"variables": ["x"], "A": [[[1, 0]]], "b": [0], "noise_covariance": [[-1]]}"#,
            "the noise covariance is not positive definite",
        ),
        (r#"{"variables": ["x"], "A": [[[1, 0]]], "b": [0]}"#, "missing field `noise_covariance`"),
    ] {
        let found = said("a.json", &format!("{{{variables}, \"factors\": [{factor}]}}"));
        assert!(found.starts_with("a.json") && found.contains(expected), "{factor}: {found}");
    }
    assert!(
        said("a.json", "{\"variables\": [\n{\"name\": 3}]}")
            .starts_with("a.json:2: is no linear-Gaussian graph")
    );
    assert!(
        said("a.json", r#"{"variables": [{"name": "x", "dim": 0}], "factors": []}"#)
            .contains("variables[0].dim is 0")
    );
}
