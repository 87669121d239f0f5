//! Values of knobs and the distributions that they are drawn from, with their form in TOML and JSON.

use std::borrow::Cow;
use std::fmt;

use serde_json::json;

use crate::random::Stream;

/// A value of a knob.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A number; whole for whole-number knobs.
    Number(f64),
    /// A colour, linear RGB.
    Rgb([f64; 3]),
    /// A text.
    Text(Cow<'static, str>),
}

/// What a knob's value is drawn from.
#[derive(Clone, Debug, PartialEq)]
pub enum Distribution {
    /// Always this value.
    Fixed(Value),
    /// Uniform in [low, high).
    Uniform {
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
    },
    /// Uniform over the whole numbers from low to high, both included.
    UniformInt {
        /// Smallest.
        low: f64,
        /// Largest.
        high: f64,
    },
    /// Uniform in the logarithm.
    LogUniform {
        /// Lower end, above 0.
        low: f64,
        /// Upper end.
        high: f64,
    },
    /// Normal; draws are clamped to the clip range.
    Normal {
        /// Mean.
        mean: f64,
        /// Standard deviation.
        sigma: f64,
        /// Clip range: lower and upper end.
        clip: [f64; 2],
    },
    /// `low + (high - low) * u^exponent` with u uniform in [0, 1).
    Power {
        /// Value for u = 0.
        low: f64,
        /// Value for u = 1.
        high: f64,
        /// Above 1 for more small values.
        exponent: f64,
    },
    /// A power distribution (uniform if the exponent is 1) whose ends are themselves drawn once per frame.
    Between {
        /// Value for u = 0.
        low: Box<Self>,
        /// Value for u = 1.
        high: Box<Self>,
        /// Above 1 for more small values.
        exponent: f64,
    },
    /// One of several values.
    Choice {
        /// The values.
        values: Vec<Value>,
        /// One weight per value.
        weights: Vec<f64>,
    },
}

impl Distribution {
    /// A fixed number.
    #[must_use]
    pub const fn number(value: f64) -> Self {
        Self::Fixed(Value::Number(value))
    }

    /// The distribution for one frame: draws random ends, lower then upper; others are returned unchanged.
    #[must_use]
    pub fn with_ends(&self, stream: &mut Stream) -> Self {
        let Self::Between { low, high, exponent } = self else { return self.clone() };
        let mut end = |from: &Self| match from.sample(stream) {
            Value::Number(value) => value,
            Value::Rgb(_) | Value::Text(_) => f64::NAN,
        };
        let (low, high) = (end(low), end(high));
        if *exponent == 1.0 {
            Self::Uniform { low, high }
        } else {
            Self::Power { low, high, exponent: *exponent }
        }
    }

    /// Draws a value.
    #[must_use]
    pub fn sample(&self, stream: &mut Stream) -> Value {
        let number = match *self {
            Self::Fixed(ref value) => return value.clone(),
            Self::Between { .. } => return self.with_ends(stream).sample(stream),
            Self::Choice { ref values, ref weights } => {
                let mut left = stream.unit() * weights.iter().sum::<f64>();
                let chosen = weights.iter().position(|weight| {
                    left -= weight;
                    left < 0.0
                });
                return values[chosen.unwrap_or(values.len() - 1)].clone();
            }
            Self::Uniform { low, high } => stream.uniform(low, high),
            Self::UniformInt { low, high } => stream.uniform_int(low as i64, high as i64) as f64,
            Self::LogUniform { low, high } => {
                libm::exp(stream.uniform(libm::log(low), libm::log(high))).clamp(low, high)
            }
            Self::Normal { mean, sigma, clip: [low, high] } => {
                (mean + sigma * stream.normal()).clamp(low, high)
            }
            Self::Power { low, high, exponent } => low + (high - low) * libm::pow(stream.unit(), exponent),
        };
        Value::Number(number)
    }

    /// The values that bound the support.
    #[must_use]
    pub fn bounds(&self) -> Vec<Value> {
        match *self {
            Self::Fixed(ref value) => vec![value.clone()],
            Self::Choice { ref values, .. } => values.clone(),
            Self::Between { ref low, ref high, .. } => [low.bounds(), high.bounds()].concat(),
            Self::Normal { clip: [low, high], .. }
            | Self::Uniform { low, high }
            | Self::UniformInt { low, high }
            | Self::LogUniform { low, high }
            | Self::Power { low, high, .. } => vec![Value::Number(low), Value::Number(high)],
        }
    }

    /// Parses the TOML form; `range` clips a normal distribution without a clip of its own.
    ///
    /// # Errors
    /// A description of what is expected.
    pub fn from_toml(value: &toml::Value, range: [f64; 2]) -> Result<Self, String> {
        match value {
            toml::Value::Table(table) => Self::from_table(table, range),
            plain => Value::from_toml(plain).map(Self::Fixed),
        }
    }

    fn from_table(table: &toml::Table, range: [f64; 2]) -> Result<Self, String> {
        const KINDS: [(&str, &str); 6] = [
            ("uniform", ""),
            ("uniform_int", ""),
            ("log_uniform", ""),
            ("normal", "clip"),
            ("power", "exponent"),
            ("choice", "weights"),
        ];
        let forms = "a value or one of {uniform=[a,b]}, {uniform_int=[a,b]}, {log_uniform=[a,b]}, \
                     {normal=[mean,sigma], clip=[a,b]}, {power=[a,b], exponent=e}, {choice=[..], weights=[..]}";
        let (kind, option) =
            *KINDS.iter().find(|(kind, _)| table.contains_key(*kind)).ok_or_else(|| forms.to_owned())?;
        if let Some(extra) = table.keys().find(|key| *key != kind && *key != option) {
            return Err(format!("`{kind}` without `{extra}`; {forms}"));
        }
        if kind == "choice" {
            return Self::choice(table);
        }
        if matches!(kind, "uniform" | "power")
            && let Some([low, high]) = table[kind].as_array().map(Vec::as_slice)
            && (low.is_table() || high.is_table())
        {
            return Self::between(low, high, table.get("exponent"), range);
        }
        let [low, high] = pair(&table[kind]).ok_or_else(|| format!("two finite numbers, {kind} = [a, b]"))?;
        let ordered =
            |condition: bool, rule: &str| if condition { Ok(()) } else { Err(format!("{kind} with {rule}")) };
        match kind {
            "uniform" => ordered(low <= high, "a <= b").map(|()| Self::Uniform { low, high }),
            "uniform_int" => {
                ordered(low <= high, "a <= b")?;
                ordered(low.fract() == 0.0 && high.fract() == 0.0, "whole numbers")?;
                Ok(Self::UniformInt { low, high })
            }
            "log_uniform" => {
                ordered(0.0 < low && low <= high, "0 < a <= b").map(|()| Self::LogUniform { low, high })
            }
            "normal" => {
                ordered(high >= 0.0, "sigma >= 0")?;
                let clip = match table.get("clip") {
                    None => range,
                    Some(clip) => {
                        let clip = pair(clip).ok_or("two finite numbers, clip = [a, b]")?;
                        ordered(clip[0] <= clip[1], "clip = [a, b], a <= b")?;
                        clip
                    }
                };
                Ok(Self::Normal { mean: low, sigma: high, clip })
            }
            _ => {
                ordered(low <= high, "a <= b")?;
                let exponent =
                    table.get("exponent").map_or(Some(1.0), number).ok_or("a number as exponent")?;
                ordered(exponent > 0.0, "an exponent above 0")?;
                Ok(Self::Power { low, high, exponent })
            }
        }
    }

    fn between(
        low: &toml::Value,
        high: &toml::Value,
        exponent: Option<&toml::Value>,
        range: [f64; 2],
    ) -> Result<Self, String> {
        let [low, high] = [Self::from_toml(low, range)?, Self::from_toml(high, range)?];
        let numbers = |end: &Self| -> Result<Vec<f64>, String> {
            let bounds = end.bounds().into_iter().map(|bound| match bound {
                Value::Number(value) => Ok(value),
                Value::Rgb(_) | Value::Text(_) => {
                    Err("ends that are numbers or distributions of them".to_owned())
                }
            });
            bounds.collect()
        };
        let lowest = numbers(&low)?.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let highest = numbers(&high)?.into_iter().fold(f64::INFINITY, f64::min);
        if lowest > highest {
            return Err(format!(
                "a lower end ({lowest} at most) that is never above the upper ({highest} at least)"
            ));
        }
        let exponent = exponent.map_or(Some(1.0), number).filter(|exponent| *exponent > 0.0);
        let exponent = exponent.ok_or("an exponent above 0")?;
        Ok(Self::Between { low: Box::new(low), high: Box::new(high), exponent })
    }

    fn choice(table: &toml::Table) -> Result<Self, String> {
        let list = table["choice"]
            .as_array()
            .filter(|list| !list.is_empty())
            .ok_or("choice = [one value or more]")?;
        let values = list.iter().map(Value::from_toml).collect::<Result<Vec<_>, _>>()?;
        let weights = match table.get("weights") {
            None => vec![1.0; values.len()],
            Some(weights) => {
                let list = weights.as_array().filter(|list| list.len() == values.len());
                let numbers: Option<Vec<f64>> = list.and_then(|list| list.iter().map(number).collect());
                numbers
                    .filter(|w| w.iter().all(|w| *w >= 0.0))
                    .filter(|w| (f64::MIN_POSITIVE..=f64::MAX).contains(&w.iter().sum()))
                    .ok_or("weights: as many numbers as choices, none below 0, with a finite sum above 0")?
            }
        };
        Ok(Self::Choice { values, weights })
    }

    /// The same form as JSON; integers if `whole`.
    #[must_use]
    pub fn to_json(&self, whole: bool) -> serde_json::Value {
        match self {
            Self::Fixed(value) => value.to_json(whole),
            Self::Uniform { low, high } => json!({ "uniform": [low, high] }),
            Self::UniformInt { low, high } => json!({ "uniform_int": [*low as i64, *high as i64] }),
            Self::LogUniform { low, high } => json!({ "log_uniform": [low, high] }),
            Self::Normal { mean, sigma, clip } => json!({ "normal": [mean, sigma], "clip": clip }),
            Self::Power { low, high, exponent } => json!({ "power": [low, high], "exponent": exponent }),
            Self::Between { low, high, exponent } if *exponent == 1.0 => {
                json!({ "uniform": [low.to_json(whole), high.to_json(whole)] })
            }
            Self::Between { low, high, exponent } => {
                json!({ "power": [low.to_json(whole), high.to_json(whole)], "exponent": exponent })
            }
            Self::Choice { values, weights } => {
                let values: Vec<_> = values.iter().map(|value| value.to_json(whole)).collect();
                json!({ "choice": values, "weights": weights })
            }
        }
    }
}

impl Value {
    fn from_toml(value: &toml::Value) -> Result<Self, String> {
        if let Some(value) = number(value) {
            return Ok(Self::Number(value));
        }
        match value {
            toml::Value::String(text) => Ok(Self::Text(text.clone().into())),
            toml::Value::Array(list) => {
                let channels: Option<Vec<f64>> = list.iter().map(number).collect();
                let rgb: Option<[f64; 3]> = channels.and_then(|channels| channels.try_into().ok());
                rgb.map(Self::Rgb)
                    .ok_or_else(|| "a value, or three numbers [r, g, b] for a colour".to_owned())
            }
            toml::Value::Float(_) => Err("a finite number".to_owned()),
            _ => Err("a number, a colour or a word".to_owned()),
        }
    }

    fn to_json(&self, whole: bool) -> serde_json::Value {
        match self {
            Self::Number(value) if whole => json!(*value as i64),
            Self::Number(value) => json!(value),
            Self::Rgb(rgb) => json!(rgb),
            Self::Text(text) => json!(text),
        }
    }
}

/// A finite number, whole or not.
fn number(value: &toml::Value) -> Option<f64> {
    match value {
        toml::Value::Integer(value) => Some(*value as f64),
        toml::Value::Float(value) => Some(*value).filter(|value| value.is_finite()),
        _ => None,
    }
}

fn pair(value: &toml::Value) -> Option<[f64; 2]> {
    match value.as_array()?.as_slice() {
        [a, b] => Some([number(a)?, number(b)?]),
        _ => None,
    }
}

/// Formats a number as TOML: integers without a decimal point, large ones with an exponent.
struct Plain(f64);

impl fmt::Display for Plain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.abs() < 1e15 { write!(f, "{}", self.0) } else { write!(f, "{:e}", self.0) }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(value) => Plain(*value).fmt(f),
            Self::Rgb([r, g, b]) => write!(f, "[{r}, {g}, {b}]"),
            Self::Text(text) => write!(f, "{text:?}"),
        }
    }
}

impl fmt::Display for Distribution {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fixed(value) => write!(f, "{value}"),
            Self::Uniform { low, high } => write!(f, "{{ uniform = [{low}, {high}] }}"),
            Self::UniformInt { low, high } => write!(f, "{{ uniform_int = [{low}, {high}] }}"),
            Self::LogUniform { low, high } => write!(f, "{{ log_uniform = [{low}, {high}] }}"),
            Self::Normal { mean, sigma, clip: [low, high] } => {
                let (mean, sigma) = (Plain(*mean), Plain(*sigma));
                write!(f, "{{ normal = [{mean}, {sigma}], clip = [{low}, {high}] }}")
            }
            Self::Between { low, high, exponent } if *exponent == 1.0 => {
                write!(f, "{{ uniform = [{low}, {high}] }}")
            }
            Self::Between { low, high, exponent } => {
                write!(f, "{{ power = [{low}, {high}], exponent = {} }}", Plain(*exponent))
            }
            Self::Power { low, high, exponent } => {
                write!(f, "{{ power = [{low}, {high}], exponent = {} }}", Plain(*exponent))
            }
            Self::Choice { values, weights } => {
                let values: Vec<String> = values.iter().map(ToString::to_string).collect();
                let weights: Vec<String> = weights.iter().map(|weight| Plain(*weight).to_string()).collect();
                write!(f, "{{ choice = [{}], weights = [{}] }}", values.join(", "), weights.join(", "))
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "expected values may be computed with std's functions")]
mod tests {
    use super::*;
    use crate::random::Streams;

    fn parse(text: &str) -> Result<Distribution, String> {
        let table: toml::Table = toml::from_str(&format!("v = {text}")).expect("TOML");
        Distribution::from_toml(&table["v"], [-100.0, 100.0])
    }

    #[test]
    fn every_form_round_trips() {
        for text in [
            "17",
            "-0.5",
            "[1, 0.97, 0.92]",
            "\"nominal\"",
            "{ uniform = [0.3, 1.3] }",
            "{ uniform_int = [75, 114] }",
            "{ log_uniform = [9000, 20000] }",
            "{ normal = [2, 0.2], clip = [1.5, 2.7] }",
            "{ power = [0.058, 0.13], exponent = 1.6 }",
            "{ choice = [\"a\", \"b\"], weights = [1, 3] }",
            "{ choice = [1, 2], weights = [1e300, 0.5] }",
            "{ normal = [-1e20, 1.5e20], clip = [1, 2] }",
            "{ power = [{ uniform = [0.04, 0.08] }, { uniform = [0.1, 0.2] }], exponent = 1.6 }",
            "{ uniform = [1, { uniform = [2, 3] }] }",
        ] {
            assert_eq!(parse(text).expect(text).to_string(), text);
        }
        assert_eq!(
            parse("{ normal = [0, 1] }").expect("clipped").to_string(),
            "{ normal = [0, 1], clip = [-100, 100] }"
        );
    }

    #[test]
    fn invalid_forms_are_refused_with_what_is_expected() {
        for (text, expected) in [
            ("nan", "finite"),
            ("inf", "finite"),
            ("{ uniform = [2, 1] }", "a <= b"),
            ("{ uniform = [1] }", "two finite numbers"),
            ("{ uniform = [{ uniform = [1, 5] }, 3] }", "never above the upper"),
            ("{ uniform = [{ choice = ['a'] }, 3] }", "ends that are numbers"),
            ("{ uniform_int = [1.5, 2] }", "whole"),
            ("{ log_uniform = [0, 1] }", "0 < a"),
            ("{ normal = [0, -1] }", "sigma"),
            ("{ power = [0, 1], exponent = 0 }", "exponent"),
            ("{ choice = [] }", "one value"),
            ("{ choice = [1, 2], weights = [1] }", "as many"),
            ("{ choice = [1, 2], weights = [0, 0] }", "sum above 0"),
            ("{ choice = [1, 2], weights = [1e308, 1e308] }", "finite sum"),
            ("{ unifrom = [1, 2] }", "uniform=[a,b]"),
            ("{ uniform = [1, 2], clip = [1, 2] }", "without `clip`"),
            ("true", "a number"),
            ("[1, 2]", "three numbers"),
        ] {
            let message = parse(text).expect_err(text);
            assert!(message.contains(expected), "{text}: {message}");
        }
    }

    #[test]
    fn random_ends_are_drawn_once_per_frame() {
        let from =
            parse("{ power = [{ uniform = [1, 2] }, { uniform = [3, 4] }], exponent = 2 }").expect("read");
        let mut lows = Vec::new();
        for seed in 0..50 {
            let Distribution::Power { low, high, exponent } =
                from.with_ends(&mut Streams::new(seed).stream("test", u64::MAX))
            else {
                panic!("a power with fixed ends");
            };
            assert!((1.0..2.0).contains(&low) && (3.0..4.0).contains(&high) && exponent == 2.0);
            lows.push(low);
        }
        lows.sort_by(f64::total_cmp);
        assert!(lows[0] < 1.2 && lows[49] > 1.8, "{lows:?}");
    }

    #[test]
    fn samples_have_the_range_and_mean_of_their_distribution() {
        for (text, mean, tolerance) in [
            ("{ uniform = [2, 4] }", 3.0, 0.02),
            ("{ uniform_int = [1, 4] }", 2.5, 0.03),
            ("{ log_uniform = [1, 100] }", 99.0 / 100_f64.ln(), 0.6),
            ("{ normal = [5, 1], clip = [0, 10] }", 5.0, 0.03),
            ("{ power = [0, 1], exponent = 1.6 }", 1.0 / 2.6, 0.01),
            ("{ choice = [0, 1], weights = [1, 3] }", 0.75, 0.02),
        ] {
            let distribution = parse(text).expect(text);
            let bounds: Vec<f64> = distribution
                .bounds()
                .iter()
                .map(|bound| if let Value::Number(n) = bound { *n } else { f64::NAN })
                .collect();
            let mut stream = Streams::new(1).stream("test", 0);
            let mut sum = 0.0;
            for _ in 0..20_000 {
                let Value::Number(drawn) = distribution.sample(&mut stream) else { panic!("a number") };
                assert!((bounds[0]..=bounds[1]).contains(&drawn), "{text}: {drawn}");
                sum += drawn;
            }
            assert!((sum / 20_000.0 - mean).abs() < tolerance, "{text}: mean {}", sum / 20_000.0);
        }
    }
}
