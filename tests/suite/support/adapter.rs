//! The adapter of the tests.

/// What `--adapter` of the tests is: a part of an adapter's name, from `REGOLITH_TEST_ADAPTER`; else `cpu`.
pub(crate) fn adapter() -> String {
    std::env::var("REGOLITH_TEST_ADAPTER")
        .ok()
        .filter(|name| !name.is_empty())
        .unwrap_or_else(|| "cpu".to_owned())
}
