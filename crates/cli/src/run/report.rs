//! The metrics as a person reads them: methods side by side, then what they say about themselves.

use sumprod_positioning::metrics::{DiagnosticValue, MethodMetrics, Report, Statistic, Verdict};

use crate::table::{Align, Table, number};

/// The table and its notes.
pub fn text(report: &Report) -> String {
    let runs = if report.runs == 1 { "1 run".to_owned() } else { format!("{} runs", report.runs) };
    let mut table = Table::new(&[
        ("method", Align::Left),
        ("RMSE [m]", Align::Right),
        ("50 % [m]", Align::Right),
        ("80 % [m]", Align::Right),
        ("95 % [m]", Align::Right),
        ("velocity RMSE [m/s]", Align::Right),
        ("NEES/dof", Align::Right),
        ("in 95 % region", Align::Right),
        ("95 % width [m]", Align::Right),
        ("N_eff", Align::Right),
        ("time [s]", Align::Right),
        ("calibrated?", Align::Left),
    ]);
    for (id, metrics) in &report.methods {
        table.row(row(id, metrics));
    }
    if let Some(bound) = &report.bound {
        table.row(vec!["bound".into(), statistic(&bound.position_rmse_m)]);
    }
    let mut text = format!("{}: {runs}, seed {}\n\n{table}", report.scenario, report.seed);
    let remarks: Vec<String> = report.methods.iter().flat_map(|(id, metrics)| remarks(id, metrics)).collect();
    if !remarks.is_empty() {
        text.push('\n');
        for remark in remarks {
            text.push_str(&remark);
            text.push('\n');
        }
    }
    text
}

fn row(id: &str, metrics: &MethodMetrics) -> Vec<String> {
    let summary = &metrics.summary;
    let quantile = |of: fn(&sumprod_positioning::metrics::Quantiles<f64>) -> f64| {
        summary.error_quantiles_m.as_ref().map_or(String::new(), |quantiles| number(of(quantiles)))
    };
    let n_eff = match metrics.diagnostics.get("n_eff") {
        Some(DiagnosticValue::Number(value)) => number(*value),
        _ => String::new(),
    };
    let calibration = metrics.calibration();
    vec![
        id.to_owned(),
        summary.position_rmse_m.as_ref().or(summary.rmse_m.as_ref()).map_or(String::new(), statistic),
        quantile(|q| q.p50),
        quantile(|q| q.p80),
        quantile(|q| q.p95),
        summary.velocity_rmse_mps.as_ref().map_or(String::new(), statistic),
        calibration
            .filter(|_| summary.position_rmse_m.is_some())
            .map_or(String::new(), |calibration| number(calibration.ratio)),
        summary.coverage95.map_or(String::new(), |share| format!("{:.1} %", 100.0 * share)),
        summary.width95.map_or(String::new(), number),
        n_eff,
        number(metrics.seconds),
        match calibration.map(|calibration| calibration.verdict) {
            None => String::new(),
            Some(Verdict::Calibrated) => "yes".into(),
            Some(Verdict::Overconfident) => "no, over-confident".into(),
            Some(Verdict::Cautious) => "no, too cautious".into(),
        },
    ]
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

/// One entry a number or array, those of a group under their dotted names.
fn told(name: &str, value: &DiagnosticValue) -> Vec<String> {
    let array = |values: &[f64]| {
        let values: Vec<String> = values.iter().map(|value| number(*value)).collect();
        format!("[{}]", values.join(" "))
    };
    match value {
        DiagnosticValue::Number(value) => vec![format!("{name} {}", number(*value))],
        DiagnosticValue::Group(kinds) => {
            kinds.iter().map(|(kind, value)| format!("{name}.{kind} {}", number(*value))).collect()
        }
        DiagnosticValue::List(values) => vec![format!("{name} {}", array(values))],
        DiagnosticValue::Lists(kinds) => {
            kinds.iter().map(|(kind, values)| format!("{name}.{kind} {}", array(values))).collect()
        }
    }
}

fn remarks(id: &str, metrics: &MethodMetrics) -> Vec<String> {
    let own = metrics.diagnostics.iter().filter(|(name, _)| *name != "n_eff");
    let reported: Vec<String> = own.flat_map(|(name, value)| told(name, value)).collect();
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
