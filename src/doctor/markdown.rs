//! The report for people: the verdict first, then what to do, then the figures behind it.
//!
//! Must not know: how anything was found.

use std::fmt::Write as _;

use super::cases::CASES;
use super::compare::Verdict;
use super::examination::{Check, Examination, Run};
use super::worker::Job;

/// The verdict in a line.
fn verdict(examination: &Examination) -> String {
    let opened = examination.runs.iter().find_map(|run| run.opened.as_ref());
    let Some(opened) = opened else {
        return "Nothing could be rendered: no adapter could be opened.".to_owned();
    };
    let right = examination.right_backends();
    let auto = format!("`--raster auto` uses {} here", opened.auto_raster);
    if examination.is_right() {
        let failed: Vec<String> = examination
            .runs
            .iter()
            .filter(|run| !run.failures.is_empty())
            .map(|run| run.job.name())
            .collect();
        let besides = if failed.is_empty() {
            String::new()
        } else {
            format!(" Steps that check no labels failed: {}.", failed.join(", "))
        };
        return format!(
            "Labels are right on {}, with every backend ({}); {auto}.{besides}",
            opened.adapter,
            right.join(", ")
        );
    }
    match right.as_slice() {
        [] => format!("LABELS ARE NOT RIGHT on {}, with any backend; {auto}.", opened.adapter),
        names => {
            let rasters = ["host", "compute", "device"].into_iter().filter(|raster| {
                let of_raster = |backend: &String| backend.split('-').next() == Some(raster);
                let rendered = examination.render_runs().map(Run::backend).filter(of_raster).count();
                rendered > 0 && names.iter().filter(|name| of_raster(name)).count() == rendered
            });
            let mut ways_out: Vec<String> = rasters.map(|raster| format!("`--raster {raster}`")).collect();
            ways_out.push("another `--adapter`".to_owned());
            format!(
                "NOT EVERYTHING IS RIGHT on {}: of the backends only {} is right; {auto}. Until this is fixed, use {}.",
                opened.adapter,
                names.join(", "),
                ways_out.join(" or "),
            )
        }
    }
}

/// The verdict, what is wrong and what to do: what a terminal shows.
#[must_use]
pub fn summary(examination: &Examination) -> String {
    let mut text = format!("{}\n", verdict(examination));
    for finding in examination.findings() {
        let _ = writeln!(text, "\n{}: {}.", finding.seen, finding.means);
        if finding.is_problem() {
            let _ = writeln!(text, "  -> {}", finding.remedy);
        }
    }
    let checks = examination.checks();
    let wrong: Vec<&Check> =
        checks.iter().filter(|check| check.difference.verdict == Verdict::Wrong).collect();
    let failures =
        examination.runs.iter().flat_map(|run| run.failures.iter().map(move |failure| (run, failure)));
    for (run, failure) in failures {
        let _ = writeln!(text, "\nFAILED: {}, {}: {}", run.backend(), failure.step, failure.message);
    }
    if !wrong.is_empty() {
        text.push('\n');
    }
    for check in wrong {
        let _ = writeln!(text, "WRONG: {}", sentence(check));
    }
    let deviating = checks.iter().filter(|check| check.difference.verdict == Verdict::Deviates).count();
    if deviating > 0 {
        let total = checks.len();
        let _ = writeln!(
            text,
            "\n{deviating} of {total} checks deviate, which does not make labels wrong; the report has them."
        );
    }
    text
}

fn sentence(check: &Check) -> String {
    let against =
        if check.against.is_empty() { String::new() } else { format!(" against {}", check.against) };
    format!(
        "{} on {}, {}{against}: {}",
        check.case, check.backend, check.difference.plane, check.difference.text
    )
}

/// The report as Markdown.
#[must_use]
pub fn report(examination: &Examination) -> String {
    let mut text =
        format!("# regolith-render {}: doctor\n\n**{}**\n", env!("CARGO_PKG_VERSION"), verdict(examination));
    findings(&mut text, examination);
    adapters(&mut text, examination);
    checks(&mut text, examination);
    failures(&mut text, examination);
    speed(&mut text, examination);
    limits(&mut text, examination);
    hashes(&mut text, examination);
    machine(&mut text, examination);
    text
}

fn findings(text: &mut String, examination: &Examination) {
    text.push_str("\n## This machine\n\n| seen | meaning | what to do |\n|---|---|---|\n");
    for finding in examination.findings() {
        let remedy = if finding.is_problem() { finding.remedy.as_str() } else { "nothing" };
        let _ = writeln!(text, "| {} | {} | {} |", cell(&finding.seen), cell(&finding.means), cell(remedy));
    }
}

/// A text as the cell of a table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}

fn adapters(text: &mut String, examination: &Examination) {
    text.push_str(
        "\n## Adapters, best first\n\n| adapter | kind | API | driver | lacks |\n|---|---|---|---|---|\n",
    );
    for adapter in &examination.adapters {
        let lacks =
            if adapter.missing.is_empty() { "nothing".to_owned() } else { adapter.missing.join(", ") };
        let [name, kind] = [&adapter.name, &adapter.kind].map(|value| cell(value));
        let _ =
            writeln!(text, "| {name} | {kind} | {} | {} | {lacks} |", adapter.backend, cell(&adapter.driver));
    }
}

/// A row for each case and backend: a word for each plane, then the checks that are not right in full.
fn checks(text: &mut String, examination: &Examination) {
    const PLANES: [&str; 5] = ["mask", "instances", "depth", "colour", "repeat"];
    let checks = examination.checks();
    text.push_str(
        "\n## Checks\n\nThe host backend is compared with the shipped reference: masks and ids exactly. The others are compared \
         with the host backend where its labels are right, else with the reference: masks and ids may differ on outlines only, those of `compute` nowhere. Each frame is \
         rendered twice and must \
         repeat its bytes.\n\n| case | backend | mask | ids | depth | colour | repeats |\n|---|---|---|---|---|---|---|\n",
    );
    for case in &CASES {
        for run in examination.render_runs() {
            let own =
                || checks.iter().filter(|check| check.case == case.name && check.backend == run.backend());
            let words = PLANES.map(|plane| {
                let of_plane = own().filter(|check| check.difference.plane.split(' ').next() == Some(plane));
                of_plane.map(|check| check.difference.verdict).max().map_or("not rendered", Verdict::name)
            });
            let _ = writeln!(text, "| {} | {} | {} |", case.name, run.backend(), words.join(" | "));
        }
    }
    let (right, others): (Vec<&Check>, Vec<&Check>) =
        checks.iter().partition(|check| check.difference.verdict == Verdict::Right);
    if !others.is_empty() {
        text.push_str("\nNot right:\n\n");
    }
    for check in others {
        let _ = writeln!(text, "* {}: {}", check.difference.verdict.name(), sentence(check));
    }
    text.push_str("\n<details><summary>Figures of the checks that are right</summary>\n\n");
    for check in right {
        let _ = writeln!(text, "* {}", sentence(check));
    }
    text.push_str("\n</details>\n");
}

fn failures(text: &mut String, examination: &Examination) {
    let skipped = examination.runs.iter().filter_map(|run| Some((run, run.unsupported.as_ref()?)));
    for (run, reason) in skipped {
        let _ =
            writeln!(text, "\nNot supported by the adapter, which is no fault: {}: {reason}", run.job.name());
    }
    if examination.runs.iter().all(|run| run.failures.is_empty()) {
        return;
    }
    text.push_str("\n## Steps that failed\n\n| process | step | message |\n|---|---|---|\n");
    for run in &examination.runs {
        for failure in &run.failures {
            let _ = writeln!(
                text,
                "| {} | {} | {} |",
                run.job.name(),
                cell(&failure.step),
                cell(&failure.message)
            );
        }
    }
}

fn speed(text: &mut String, examination: &Examination) {
    text.push_str(
        "\n## Speed\n\n256 x 256 pixels, 4 samples, a few frames: enough to see which path is taken, too few to quote. `regolith-render \
         bench` measures.\n\n| case | frames/s | median ms | stages, median ms |\n|---|---|---|---|\n",
    );
    let benches = || examination.runs.iter().flat_map(|run| &run.benches);
    for (name, result) in benches() {
        let number = |key: &str| result[key].as_f64().unwrap_or_default();
        let stages = result["stage_ms"].as_object().into_iter().flatten();
        let stages: Vec<String> =
            stages.filter_map(|(stage, ms)| Some(format!("{stage} {:.1}", ms.as_f64()?))).collect();
        let _ = writeln!(
            text,
            "| {name} | {:.1} | {:.1} | {} |",
            number("frames_per_second"),
            number("median_ms"),
            stages.join(", ")
        );
    }
    text.push_str("\n| process | backend | seconds | peak resident MB | device MB in use | device MB allocated |\n|---|---|---|---|---|---|\n");
    for run in &examination.runs {
        let memory = run.memory.unwrap_or_default();
        let megabytes =
            |bytes: Option<u64>| bytes.map_or("".to_owned(), |bytes| format!("{:.0}", bytes as f64 / 1e6));
        let [rss, used, reserved] =
            [memory.peak_rss_bytes, memory.device_used_bytes, memory.device_reserved_bytes].map(megabytes);
        let backend = if run.job == Job::Adapters { String::new() } else { run.backend() };
        let _ = writeln!(
            text,
            "| {} | {backend} | {:.1} | {rss} | {used} | {reserved} |",
            run.job.name(),
            run.seconds
        );
    }
}

fn limits(text: &mut String, examination: &Examination) {
    let opened = examination.runs.iter().find_map(|run| run.opened.as_ref());
    let chosen = examination
        .adapters
        .iter()
        .find(|adapter| opened.is_some_and(|opened| opened.adapter == adapter.describe()));
    let Some(adapter) = chosen else { return };
    let _ = writeln!(
        text,
        "\n## Limits of {}\n\n| limit | needed | requested | offered |\n|---|---|---|---|",
        adapter.name
    );
    for limit in &adapter.limits {
        let mark = if limit.offered < limit.needed { " (TOO LITTLE)" } else { "" };
        let _ = writeln!(
            text,
            "| {} | {} | {} | {}{mark} |",
            limit.name, limit.needed, limit.requested, limit.offered
        );
    }
    let capabilities = opened.into_iter().flat_map(|opened| &opened.capabilities);
    let capabilities: Vec<String> = capabilities
        .map(|(name, has)| format!("{name} {}", if has.as_bool() == Some(true) { "yes" } else { "no" }))
        .collect();
    let _ = writeln!(text, "\nOptional: {}.", capabilities.join(", "));
}

fn hashes(text: &mut String, examination: &Examination) {
    text.push_str(
        "\n## Hashes\n\nOf the first rendering; two machines with the same hashes have the same bytes.\n\n\
         | case | backend | mask | ids | depth | colour |\n|---|---|---|---|---|---|\n",
    );
    for run in examination.render_runs() {
        for (case, hashes) in Examination::hashes(run) {
            let [mask, ids, depth, rgb] = [&hashes.mask, &hashes.instances, &hashes.depth, &hashes.rgb]
                .map(|hash| hash.get(..12).unwrap_or(hash));
            let _ = writeln!(text, "| {case} | {} | {mask} | {ids} | {depth} | {rgb} |", run.backend());
        }
    }
}

fn machine(text: &mut String, examination: &Examination) {
    let machine = examination.hardware.to_json();
    let _ = writeln!(text, "\n## Machine\n\n```json\n{machine:#}\n```");
    let has_messages = |run: &&Run| !run.messages.is_empty();
    for run in examination.runs.iter().filter(has_messages) {
        let _ = writeln!(
            text,
            "\nMessages of the process `{}` and its driver:\n\n```text\n{}\n```",
            run.job.name(),
            run.messages.join("\n")
        );
    }
}
