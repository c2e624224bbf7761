//! `zonal materials`.

use zonal::reflectance::built_in;

use crate::common::Report;

pub fn run() -> anyhow::Result<Report> {
    let all = built_in();
    let width = all.iter().map(|m| m.name.len()).max().unwrap_or(0);
    let rows: Vec<String> = all.iter().map(|m| format!("{:width$}  {:8}  {}", m.name, m.family, m.source)).collect();
    let json = all
        .iter()
        .map(|m| serde_json::json!({ "name": m.name, "family": m.family, "source": m.source }))
        .collect::<Vec<_>>();
    Ok(Report { text: rows.join("\n"), json: serde_json::json!({ "materials": json }) })
}
