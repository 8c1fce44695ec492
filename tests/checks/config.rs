//! `config.toml`: an input is its text.

use super::Target;
use descan::shell::config::UserSettings;

/// Target `config`.
pub const CONFIG: Target = Target {
    name: "config",
    check: |input| {
        let Ok(text) = str::from_utf8(input) else { return };
        match UserSettings::parse(text) {
            Ok(settings) => {
                for share in [settings.start_share, settings.steady_share].into_iter().flatten() {
                    assert!((0.001..=1.0).contains(&share), "{share}");
                }
                let budget = settings.screen_budget.unwrap_or(1800.0);
                assert!((200.0..=1e6).contains(&budget), "{budget}");
                assert!(settings.round_period().is_none_or(|period| period.as_secs() <= 86_400));
            }
            Err(message) => assert!(!message.is_empty()),
        }
    },
    words: &[
        b"theme = \"dark\"\n",
        b"round_period = ",
        b"start_share = ",
        b"steady_share = ",
        b"screen_budget = ",
        b"0.001",
        b"nan",
        b"inf",
        b"-0.0",
        b"86400",
        b"1e-400",
        b"1e308",
        b"[",
        b"]",
        b"{",
        b"\"\"\"",
        b"\\u0000",
        b"1979-05-27T07:32:00Z",
        b"0x",
        b"_",
        b"a.b.c = ",
        b"# ",
    ],
};
