//! `params` and `presets`: what can be set, and sets of it.

use crate::dataset::rules::Rules;
use crate::error::nearest;
use crate::error::{Error, Result};
use crate::params::config::Config;
use crate::params::groups::GROUPS;
use crate::params::presets::{preset_description, presets};
use crate::params::{KNOBS, KnobInfo};
use clap::Args;
use serde_json::{Value, json};

use super::args::ConfigArgs;
use super::messages::print;

/// The section of a configuration that has no knobs.
const RULES: &str = "rules";

#[derive(Args, Debug)]
pub(super) struct ParamsArgs {
    /// A knob (sun.elevation_deg) or a section of knobs (sun); all if left out
    #[arg(value_name = "KNOB")]
    knob: Option<String>,
    #[command(flatten)]
    config: ConfigArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args, Debug)]
pub(super) struct PresetsArgs {
    /// A preset, whose file is printed; all with a line each if left out
    #[arg(value_name = "NAME")]
    name: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Lists the knobs, those of a section, or one.
pub(super) fn list_params(args: &ParamsArgs) -> Result<()> {
    let config = args.config.build()?;
    let rules = Rules::from_config(&config)?;
    let Some(name) = &args.knob else {
        if args.json {
            return print(&format!("{:#}\n", config.to_json()));
        }
        return print(&format!("{}\n{}", config.to_toml(), rules.to_toml()));
    };
    if name == RULES {
        return print(&if args.json { format!("{:#}\n", rules.to_json()) } else { rules.to_toml() });
    }
    let is_listed = |info: &KnobInfo| info.name == name || info.section() == name;
    let text = config.to_toml_where(is_listed);
    if text.is_empty() {
        return Err(no_such_knob(name, &config));
    }
    if !args.json {
        return print(&text);
    }
    let rows = config.to_json();
    let is_row = |row: &&Value| {
        let known = row["name"].as_str().unwrap_or_default();
        KNOBS.iter().any(|info| info.name == known && is_listed(info))
    };
    let rows: Vec<&Value> = rows.as_array().into_iter().flatten().filter(is_row).collect();
    print(&format!("{:#}\n", json!(rows)))
}

/// Why nothing is listed for a name: no knob has it, or none of the stage.
fn no_such_knob(name: &str, config: &Config) -> Error {
    let elsewhere = KNOBS.iter().find(|info| info.name == name || info.section() == name);
    if let Some(stage) = elsewhere.and_then(|info| info.stage) {
        let own: Vec<&str> = config.stages().iter().map(|stage| stage.name()).collect();
        return Error::Usage(format!(
            "`{name}` is of the stage {0}, and not of {1}; add --stage {0}",
            stage.name(),
            own.join(", ")
        ));
    }
    let sections = GROUPS.iter().flat_map(|(.., sections)| sections.iter().copied()).chain([RULES]);
    Error::UnknownKnob {
        name: name.to_owned(),
        origin: "the command line".to_owned(),
        suggestion: nearest(name, KNOBS.iter().map(|info| info.name).chain(sections)),
    }
}

/// Lists the presets, or prints one.
pub(super) fn list_presets(args: &PresetsArgs) -> Result<()> {
    let description = |name: &str| preset_description(name).unwrap_or_default();
    if let Some(name) = &args.name {
        let mut config = Config::new();
        config.apply_preset(name)?;
        let text = presets().into_iter().find(|(known, _)| known == name).map_or("", |(_, text)| text);
        if args.json {
            let row = json!({ "name": name, "description": description(name), "knobs": config.distributions_json() });
            return print(&format!("{row:#}\n"));
        }
        return print(text);
    }
    if args.json {
        let rows: Vec<Value> = presets()
            .iter()
            .map(|(name, _)| json!({ "name": name, "description": description(name) }))
            .collect();
        return print(&format!("{:#}\n", Value::from(rows)));
    }
    print(&presets_help())
}

/// A line for each preset.
pub(super) fn presets_help() -> String {
    let row =
        |(name, _): &(&str, &str)| format!("  {name:<22} {}\n", preset_description(name).unwrap_or_default());
    presets().iter().map(row).collect()
}

/// A line for each group of knobs.
pub(super) fn groups_help() -> String {
    let row = |(title, what, sections): &(&str, &str, &[&str])| {
        let known = |section: &&&str| KNOBS.iter().any(|info| info.section() == **section);
        let sections: Vec<&str> = sections.iter().filter(known).copied().collect();
        if sections.is_empty() {
            String::new()
        } else {
            format!("  {title:<14} {what}: {}\n", sections.join(", "))
        }
    };
    GROUPS.iter().map(row).collect()
}
