//! The options of the manifest's command that set the knobs or name the rasteriser, against the configuration of the dataset. What follows
//! them in the command is derived from other keys.
//!
//! Must not know: the rest of the manifest.

use serde_json::{Map, Value};

use super::context::Context;
use crate::dataset::manifest::{shell_word, shell_words};
use crate::dataset::rules::Rules;
use crate::error::Result;
use crate::params::config::Config;
use crate::render::RasterMode;

/// The options in the order of the command; `--set` can occur several times.
const OPTIONS: [&str; 5] = ["--stage", "--preset", "--config", SET, "--raster"];
const SET: &str = "--set";

/// What is wrong with the options; `None` if they give the configuration of the dataset. Of those beside `--config`, whose file is not
/// there, the knobs of `--set` must be in the configuration, and presets and stages must exist.
pub(super) fn options_problem(context: &Context<'_>, options: &str) -> Option<String> {
    let pairs = match pairs_of(options) {
        Ok(pairs) => pairs,
        Err(problem) => return Some(problem),
    };
    let values = |option: &'static str| values_of(&pairs, option);
    if let Some(mode) = values("--raster").next().filter(|mode| mode.parse::<RasterMode>().is_err()) {
        return Some(format!("--raster {mode} is no rasteriser"));
    }
    let found = if values("--config").next().is_some() {
        difference_beside_file(context, &pairs)
    } else {
        difference(context, &pairs)
    };
    found.unwrap_or_else(|error| Some(error.to_string()))
}

/// Where the dataset differs from what options without a file give; none if nowhere.
fn difference(context: &Context<'_>, pairs: &[(&'static str, String)]) -> Result<Option<String>> {
    let presets = values_of(pairs, "--preset").flat_map(|names| names.split(','));
    let config = Config::layered(values_of(pairs, "--stage").next(), presets, |config| {
        values_of(pairs, SET).try_for_each(|assignment| config.apply_set(assignment))
    })?;
    let rules = Rules::from_config(&config)?;
    // In the form in which the recorded ones were read.
    let mut read = Config::new();
    read.apply_json(&config.distributions_json(), "command")?;
    let other_rules = || {
        let is_other = rules.to_json() != context.plan.rules.to_json();
        is_other.then(|| "its options give other rules than rules has".to_owned())
    };
    Ok(other_knob(&read, &context.plan.config).or_else(other_rules))
}

/// The same of options beside a file, which is not there: names must exist, and the knobs of `--set` win over the file, so that they change
/// nothing where they are set once more.
fn difference_beside_file(context: &Context<'_>, pairs: &[(&'static str, String)]) -> Result<Option<String>> {
    values_of(pairs, "--stage").try_for_each(|stage| Config::new().set_stage(stage))?;
    let mut presets = values_of(pairs, "--preset").flat_map(|names| names.split(','));
    presets.try_for_each(|preset| Config::new().apply_preset(preset))?;
    let mut again = context.plan.config.clone();
    values_of(pairs, SET).try_for_each(|assignment| again.apply_set(assignment))?;
    Rules::from_config(&again)?;
    Ok(other_knob(&again, &context.plan.config))
}

/// The first knob that is drawn from something else than recorded, in words.
fn other_knob(given: &Config, recorded: &Config) -> Option<String> {
    let [given, recorded] = [given, recorded].map(Config::distributions_json);
    first_difference(&given, &recorded).map(|knob| format!("its options give another {knob} than config has"))
}

/// The options with their values. Words that are no option, are not in the order of the command or are written in another way than
/// `dataset` writes them are a problem: a shell may read more in them.
fn pairs_of(options: &str) -> std::result::Result<Vec<(&'static str, String)>, String> {
    if options.is_empty() {
        return Ok(Vec::new());
    }
    let words = shell_words(options);
    let mut pairs: Vec<(&'static str, String)> = Vec::new();
    let rank = |option: &str| OPTIONS.iter().position(|known| *known == option);
    for pair in words.chunks(2) {
        let [word, value] = pair else {
            return Err(format!("the word {} has no value", shell_word(&pair[0])));
        };
        let Some(option) = rank(word).map(|rank| OPTIONS[rank]) else {
            return Err(format!("the word {} is no option of the knobs or the rasteriser", shell_word(word)));
        };
        let is_in_order =
            pairs.last().is_none_or(|(last, _)| rank(last) < rank(option) || (*last, option) == (SET, SET));
        if !is_in_order {
            return Err(format!("{option} occurs twice, or behind an option that follows it"));
        }
        pairs.push((option, value.clone()));
    }
    let written: Vec<String> =
        pairs.iter().map(|(option, value)| format!("{option} {}", shell_word(value))).collect();
    let written = written.join(" ");
    if written == options { Ok(pairs) } else { Err(format!("its options should be written as {written}")) }
}

fn values_of<'a>(pairs: &'a [(&'static str, String)], option: &'static str) -> impl Iterator<Item = &'a str> {
    pairs.iter().filter(move |(name, _)| *name == option).map(|(_, value)| value.as_str())
}

/// The name of the first knob that differs.
fn first_difference<'a>(a: &'a Map<String, Value>, b: &'a Map<String, Value>) -> Option<&'a str> {
    let differs = |key: &&String| a.get(key.as_str()) != b.get(key.as_str());
    a.keys().chain(b.keys()).find(differs).map(String::as_str)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_options_as_a_command_has_them_are_read() {
        for options in [
            "",
            "--raster host",
            "--stage surface --preset train_dr,sun_polar --set a=1 --set b=2 --raster compute",
            r"--config 'a b'\''s.toml' --set 'rocks.scale_m={uniform=[0.4, 1]}'",
        ] {
            let pairs = pairs_of(options).expect(options);
            assert_eq!(pairs.len(), options.matches("--").count(), "{options}");
        }
        for (options, said) in [
            ("--preset", "--preset has no value"),
            ("--preset train_dr; rm -rf /", "the word rm is no option"),
            ("--seed 3", "the word --seed is no option"),
            ("--preset train_dr;rm", "should be written as"),
            ("--config $(rm)", "should be written as --config '$(rm)'"),
            ("--config 'a.toml'", "should be written as --config a.toml"),
            ("--preset a --stage b", "--stage occurs twice"),
            ("--preset a --preset b", "--preset occurs twice"),
            ("--set a=1  --set b=2", "is no option"),
        ] {
            let problem = pairs_of(options).expect_err(options);
            assert!(problem.contains(said), "{options}: {problem}");
        }
    }
}
