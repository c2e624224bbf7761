//! `zonal devices`.

use zonal::devices::list;

use crate::common::Report;

pub fn run() -> anyhow::Result<Report> {
    let listing = list();
    Ok(Report { text: listing.text(), json: serde_json::to_value(&listing)? })
}
