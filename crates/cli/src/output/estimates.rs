//! `estimates.csv`: one line an estimate.
//!
//! Columns: run, method, node, step, time_s; then for each component of the state its true value (`true_x_m`) and
//! its estimate (`x_m`); then the lower triangle of the covariance (`cov_x_m_x_m`). A method whose state lacks a
//! component leaves its cells empty.

use std::fmt::Write;

use sumprod_positioning::results::{MethodRun, RunResult};

/// The whole table.
pub fn csv(runs: &[RunResult]) -> String {
    let names = components(runs);
    let mut text = String::from("run,method,node,step,time_s");
    for name in &names {
        text.extend([",true_", *name, ",", *name]);
    }
    for (i, a) in names.iter().enumerate() {
        for b in &names[..=i] {
            text.extend([",cov_", *a, "_", *b]);
        }
    }
    text.push('\n');
    for run in runs {
        for method in &run.methods {
            lines(&mut text, run, method, &names);
        }
    }
    text
}

/// Names of all components, in the order in which they first occur.
fn components(runs: &[RunResult]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for name in runs.iter().flat_map(|run| &run.methods).flat_map(|method| &method.layout.names) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    names
}

fn lines(text: &mut String, run: &RunResult, method: &MethodRun, names: &[&str]) {
    let places: Vec<Option<usize>> =
        names.iter().map(|name| method.layout.names.iter().position(|own| own == name)).collect();
    for estimate in method.estimates() {
        let node = run.nodes.get(estimate.node as usize).map_or("", String::as_str);
        let (step, time) = (estimate.step, estimate.time);
        // Writing to a string cannot fail.
        let _ = write!(text, "{},{},{},{step},{time}", run.run, quoted(&method.id), quoted(node));
        for place in &places {
            let _ = match place {
                Some(i) => write!(text, ",{},{}", estimate.truth[*i], estimate.mean[*i]),
                None => write!(text, ",,"),
            };
        }
        for (k, a) in places.iter().enumerate() {
            for b in &places[..=k] {
                let _ = match (a, b) {
                    (Some(i), Some(j)) => write!(text, ",{}", estimate.covariance_at(*i, *j)),
                    _ => write!(text, ","),
                };
            }
        }
        text.push('\n');
    }
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumprod_positioning::results::StateLayout;

    #[test]
    fn components_that_a_method_lacks_are_empty() {
        let mut position = MethodRun::new("p", StateLayout::planar_position());
        position.push(1, 0.5, 0, &[1.0, 2.0], &[1.5, 2.5], &[4.0, 1.0, 1.0, 9.0]).unwrap();
        let mut pose = MethodRun::new("q", StateLayout::planar_pose());
        let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        pose.push(1, 0.5, 0, &[1.0, 2.0, 3.0], &[1.0, 2.0, 3.0], &identity).unwrap();
        let run =
            RunResult { nodes: vec!["a, b".into()], methods: vec![position, pose], ..RunResult::default() };
        let expected = "\
run,method,node,step,time_s,true_x_m,x_m,true_y_m,y_m,true_heading_rad,heading_rad,\
cov_x_m_x_m,cov_y_m_x_m,cov_y_m_y_m,cov_heading_rad_x_m,cov_heading_rad_y_m,cov_heading_rad_heading_rad
0,p,\"a, b\",1,0.5,1,1.5,2,2.5,,,4,1,9,,,
0,q,\"a, b\",1,0.5,1,1,2,2,3,3,1,0,1,0,0,1
";
        assert_eq!(csv(&[run]), expected);
    }
}
