//! The metrics as a person reads them: methods side by side, then what they say about themselves.

use sumprod_positioning::metrics::{DiagnosticValue, MethodMetrics, Report, Statistic, Verdict};

use crate::table::{Align, Table, number};

/// Figures that some systems report beside the common ones, with their columns.
const OWN_COLUMNS: &[(&str, &str)] = &[
    ("n_eff", "N_eff"),
    ("association.correct", "correct"),
    ("association.false", "false"),
    ("disagreement", "disagreement [m]"),
    ("claimed_trace", "claimed trace [m²]"),
];

/// What the last column means.
const VERDICT: &str = "\ncalibrated: the errors are as large as the method says, by NEES/dof near 1 and 95 % of truths inside the 95 %\nregion, as far as this many runs can tell\n";

/// The columns of the table of methods.
pub fn columns() -> Vec<(&'static str, Align)> {
    let common = [
        ("method", Align::Left),
        ("RMSE [m]", Align::Right),
        ("of the last ten [m]", Align::Right),
        ("50 % [m]", Align::Right),
        ("80 % [m]", Align::Right),
        ("95 % [m]", Align::Right),
        ("velocity RMSE [m/s]", Align::Right),
        ("clock RMSE [s]", Align::Right),
        ("skew RMSE [ppm]", Align::Right),
        ("NEES/dof", Align::Right),
        ("in 95 % region", Align::Right),
        ("95 % width [m]", Align::Right),
    ];
    let own = OWN_COLUMNS.iter().map(|&(_, heading)| (heading, Align::Right));
    let last = [("time of all runs [s]", Align::Right), ("calibrated?", Align::Left)];
    common.into_iter().chain(own).chain(last).collect()
}

/// The table and its notes.
pub fn text(report: &Report) -> String {
    let mut table = Table::new(&columns());
    for row in rows(report) {
        table.row(row);
    }
    let mut text = format!("{}: {}, seed {}\n\n{table}", report.scenario, runs(report), report.seed);
    let remarks: Vec<String> = report.methods.iter().flat_map(|(id, metrics)| remarks(id, metrics)).collect();
    if report.methods.iter().any(|(_, metrics)| metrics.calibration().is_some()) {
        text.push_str(VERDICT);
    }
    if !remarks.is_empty() {
        text.push('\n');
        for remark in remarks {
            text.push_str(&remark);
            text.push('\n');
        }
    }
    text
}

/// How many runs, in words.
pub fn runs(report: &Report) -> String {
    if report.runs == 1 { "1 run".to_owned() } else { format!("{} runs", report.runs) }
}

/// The rows of the table of methods.
pub fn rows(report: &Report) -> Vec<Vec<String>> {
    let mut rows: Vec<Vec<String>> = report.methods.iter().map(|(id, metrics)| row(id, metrics)).collect();
    if let Some(bound) = &report.bound {
        rows.push(vec!["bound".into(), statistic(&bound.position_rmse_m)]);
    }
    rows
}

fn row(id: &str, metrics: &MethodMetrics) -> Vec<String> {
    let summary = &metrics.summary;
    let quantile = |of: fn(&sumprod_positioning::metrics::Quantiles<f64>) -> f64| {
        summary.error_quantiles_m.as_ref().map_or(String::new(), |quantiles| number(of(quantiles)))
    };
    let calibration = metrics.calibration();
    let mut cells = vec![
        id.to_owned(),
        summary.position_rmse_m.as_ref().or(summary.rmse_m.as_ref()).map_or(String::new(), statistic),
        metrics.final_rmse_m.as_ref().map_or(String::new(), statistic),
        quantile(|q| q.p50),
        quantile(|q| q.p80),
        quantile(|q| q.p95),
        summary.velocity_rmse_mps.as_ref().map_or(String::new(), statistic),
        summary.clock_offset_rmse_s.as_ref().map_or(String::new(), statistic),
        summary.clock_skew_rmse_ppm.as_ref().map_or(String::new(), statistic),
        calibration
            .filter(|_| summary.position_rmse_m.is_some())
            .map_or(String::new(), |calibration| number(calibration.ratio)),
        summary.coverage95.map_or(String::new(), |share| format!("{:.1} %", 100.0 * share)),
        summary.width95.map_or(String::new(), number),
    ];
    cells.extend(OWN_COLUMNS.iter().map(|(name, _)| {
        let value = metrics.diagnostic(name).map(|mean| Statistic { mean, se: metrics.standard_error(name) });
        value.as_ref().map_or(String::new(), statistic)
    }));
    cells.extend([
        number(metrics.seconds),
        match calibration.map(|calibration| calibration.verdict) {
            None => String::new(),
            Some(Verdict::Calibrated) => "yes".into(),
            Some(Verdict::Overconfident) => "no, over-confident".into(),
            Some(Verdict::Cautious) => "no, too cautious".into(),
        },
    ]);
    cells
}

fn statistic(statistic: &Statistic<f64>) -> String {
    match statistic.se {
        Some(se) => {
            let mean = number(statistic.mean);
            let decimals = mean.split_once('.').map_or(0, |(_, decimals)| decimals.len());
            if mean.contains('e') {
                format!("{mean} ± {}", number(se))
            } else {
                format!("{mean} ± {se:.decimals$}")
            }
        }
        None => number(statistic.mean),
    }
}

/// One name and value for a number or array, those of a group under their dotted names.
fn told(name: &str, value: &DiagnosticValue) -> Vec<(String, String)> {
    let array = |values: &[f64]| {
        let values: Vec<String> = values.iter().map(|value| number(*value)).collect();
        format!("[{}]", values.join(" "))
    };
    match value {
        DiagnosticValue::Number(value) => vec![(name.to_owned(), number(*value))],
        DiagnosticValue::Group(kinds) => {
            kinds.iter().map(|(kind, value)| (format!("{name}.{kind}"), number(*value))).collect()
        }
        DiagnosticValue::List(values) => vec![(name.to_owned(), array(values))],
        DiagnosticValue::Lists(kinds) => {
            kinds.iter().map(|(kind, values)| (format!("{name}.{kind}"), array(values))).collect()
        }
    }
}

fn remarks(id: &str, metrics: &MethodMetrics) -> Vec<String> {
    let in_columns = |name: &str| OWN_COLUMNS.iter().any(|(column, _)| *column == name);
    let reported: Vec<String> = metrics
        .diagnostics
        .iter()
        .flat_map(|(name, value)| told(name, value))
        .filter(|(name, _)| !in_columns(name))
        .map(|(name, value)| format!("{name} {value}"))
        .collect();
    let singular = metrics.summary.nees.as_ref().and_then(|nees| nees.position.as_ref()?.singular);
    let mut lines = Vec::new();
    if !reported.is_empty() {
        lines.push(format!("{id}: {}", reported.join(", ")));
    }
    if let Some(count) = singular {
        lines.push(format!(
            "{id}: {count} position covariances are singular and count as not covering the truth"
        ));
    }
    lines.extend(metrics.notes.iter().map(|note| format!("{id}: {note}")));
    lines
}
