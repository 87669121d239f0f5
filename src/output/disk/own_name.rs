//! The names of the files that are not a result: files that are still being written, and locks.
//!
//! Both start with `.regolith-render-`, so that nobody else's file is taken for one:
//! `.regolith-render-0of4-Ab3dE6gH.tmp` is being written by the writer with the tag `0of4`,
//! `.regolith-render-0-of-4.lock` is the lock called `0-of-4`.
//! Must not know: who writes.

/// Start of every such name.
const PREFIX: &str = ".regolith-render-";
/// End of the name of a file that is not yet complete.
pub(super) const TEMPORARY_SUFFIX: &str = ".tmp";
/// End of the name of a lock file.
const LOCK_SUFFIX: &str = ".lock";
/// Number of random letters and digits in the name of a temporary file.
pub(super) const RANDOM_LENGTH: usize = 8;

/// The start of the names of a writer's temporary files, before the random part.
pub(super) fn temporary_prefix(tag: &str) -> String {
    format!("{PREFIX}{tag}-")
}

/// File name of the lock that is called `name`: small letters, digits and `-`.
#[must_use]
pub fn lock_file_name(name: &str) -> String {
    format!("{PREFIX}{name}{LOCK_SUFFIX}")
}

/// The tag of the writer whose temporary file has this name; `None` for any other file.
#[must_use]
pub fn temporary_tag(name: &str) -> Option<&str> {
    let middle = name.strip_prefix(PREFIX)?.strip_suffix(TEMPORARY_SUFFIX)?;
    let (tag, random) = middle.rsplit_once('-')?;
    let is_tag = !tag.is_empty() && tag.bytes().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit());
    let is_random = random.len() == RANDOM_LENGTH && random.bytes().all(|c| c.is_ascii_alphanumeric());
    (is_tag && is_random).then_some(tag)
}

/// What the lock with this file name is called; `None` for any other file.
#[must_use]
pub fn lock_name(name: &str) -> Option<&str> {
    let middle = name.strip_prefix(PREFIX)?.strip_suffix(LOCK_SUFFIX)?;
    let is_name =
        |text: &str| text.bytes().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'-');
    (!middle.is_empty() && is_name(middle)).then_some(middle)
}

/// Whether a file of this name is neither a result nor a user's file.
#[must_use]
pub fn is_own_name(name: &str) -> bool {
    temporary_tag(name).is_some() || lock_name(name).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_exact_form_is_an_own_name() {
        assert_eq!(temporary_tag(".regolith-render-0of4-Ab3dE6gH.tmp"), Some("0of4"));
        assert_eq!(lock_name(&lock_file_name("0-of-4")), Some("0-of-4"));
        for foreign in [
            ".writing-0of1-abc",
            ".lock",
            ".lock-0-of-4",
            ".locksmith",
            ".regolith-render-0of4-Ab3dE6g.tmp",
            ".regolith-render-0of4-Ab3dE6g_.tmp",
            ".regolith-render-Ab3dE6gH.tmp",
            ".regolith-render--Ab3dE6gH.tmp",
            ".regolith-render-notes-today123.tmp.md",
            "regolith-render-0of4-Ab3dE6gH.tmp",
            ".regolith-render-.lock",
            ".regolith-render-My.lock",
            ".regolith-render-folder.lock~",
        ] {
            assert!(!is_own_name(foreign), "{foreign}");
        }
    }
}
