use super::*;
use crate::testing::Walk;

const FILE: &str = "\
system = \"walk\"
runs = 3

[world]
steps = 5
process_variance = 1.0
noise_variance = 4.0

[method.kf]
form = \"gaussian\"
";

fn read(text: &str, sets: &[&str]) -> Result<(Settings, Walk), Failure> {
    let sets: Vec<String> = sets.iter().map(|&set| set.to_owned()).collect();
    Document::parse("dir/file.toml", text, &sets)?.read()
}

fn sentence(text: &str, sets: &[&str]) -> String {
    let failure = read(text, sets).unwrap_err();
    assert_eq!(failure.status(), 2);
    failure.sentence().to_owned()
}

#[test]
fn a_file_without_a_name_is_called_by_its_stem() {
    let (settings, scenario) = read(FILE, &[]).unwrap();
    assert_eq!((settings.name.as_str(), settings.runs, settings.seed), ("file", 3, 1));
    assert_eq!(scenario.methods(), ["kf"]);
}

#[test]
fn wrong_keys_and_values_are_named_with_their_line() {
    for (from, to, expected) in [
        ("steps", "stesp", "dir/file.toml:5: `world.stesp` is an unknown key; did you mean `world.steps`?"),
        ("runs", "rnus", "dir/file.toml:2: `rnus` is an unknown key; did you mean `runs`?"),
        (
            "\"gaussian\"",
            "\"gausian\"",
            "dir/file.toml:10: `method.kf.form` is `gausian`, which does not exist; choose one of gaussian, measurement",
        ),
        (
            "steps = 5",
            "steps = -5",
            "dir/file.toml:5: `world.steps` is `-5`; it must be a whole number that is not negative",
        ),
        ("steps = 5\n", "", "dir/file.toml:4: `world.steps` is missing; add it"),
        ("runs = 3", "runs = 0", "dir/file.toml:2: `runs` is 0; at least 1 run is needed"),
        (
            "process_variance = 1.0",
            "process_variance = -1.0",
            "dir/file.toml:6: `world.process_variance` is -1 m²; a variance cannot be negative",
        ),
        ("steps = 5", "steps = ", "dir/file.toml:5: this is not TOML: "),
    ] {
        let found = sentence(&FILE.replace(from, to), &[]);
        assert!(found.starts_with(expected), "{found}");
    }
}

#[test]
fn overrides_replace_and_are_blamed() {
    let (settings, _) =
        read(FILE, &["runs=7", "world.steps = 9", "description=two words", "seed=0x10"]).unwrap();
    assert_eq!((settings.runs, settings.seed, settings.description.as_str()), (7, 16, "two words"));
    for (set, expected) in [
        (
            "world.stesp=2",
            "--set world.stesp=2: `world.stesp` is an unknown key; did you mean `world.steps`?",
        ),
        ("wrld.steps=2", "--set wrld.steps=2: `wrld` is an unknown key; did you mean `world`?"),
        (
            "world.steps=many",
            "--set world.steps=many: `world.steps` is the text \"many\"; it must be a whole number that is not negative",
        ),
        ("world.process_variance=-2", "--set world.process_variance=-2: `world.process_variance` is -2 m²; "),
        (
            "method.pf.form=gaussian",
            "--set method.pf.form=gaussian: there is no method `pf`; the scenario has kf",
        ),
        (
            "world.steps.more=2",
            "--set world.steps.more=2: `world.steps` is no table but of type integer; set `world.steps` itself",
        ),
        ("world.steps", "--set world.steps: write KEY=VALUE, as in world.steps=20"),
        ("=3", "--set =3: the key is a dotted path, as in world.steps=20"),
    ] {
        let found = sentence(FILE, &[set]);
        assert!(found.starts_with(expected), "{found}");
    }
}

#[test]
fn a_base_gives_what_the_file_leaves_out() {
    let text = "base = \"walk\"\n[world]\nsteps = 3\n[method.slow]\nform = \"gaussian\"\n";
    let (settings, scenario) = read(text, &[]).unwrap();
    assert_eq!((settings.name.as_str(), settings.runs), ("file", 30));
    assert_eq!(scenario.methods(), ["kf", "boastful", "raw", "slow"]);
    let found = sentence(&text.replace("steps", "stesp"), &[]);
    assert!(found.starts_with("dir/file.toml:3: `world.stesp` is an unknown key"), "{found}");
    let found = sentence("\nbase = \"moon\"", &[]);
    assert!(
        found.starts_with("dir/file.toml:2: `base` is \"moon\", which is no built-in scenario"),
        "{found}"
    );
}

#[test]
fn inline_tables_replace_and_tables_merge() {
    let below: Table = toml::from_str("[a]\nx = 1\ny = 2\n[b]\nx = 1\n").unwrap();
    let text = "a = { y = 3 }\n[b]\ny = 3\n";
    let mut table = below;
    let over: Table = toml::from_str(text).unwrap();
    overrides::merge(&mut table, &over, DeTable::parse(text).unwrap().get_ref(), text);
    let expected: Table = toml::from_str("a = { y = 3 }\nb = { x = 1, y = 3 }").unwrap();
    assert_eq!(table, expected);
}

#[test]
fn a_missing_system_and_an_unknown_scenario_say_what_to_do() {
    let found = Document::parse("f.toml", "runs = 1", &[]).unwrap().system().unwrap_err();
    assert!(found.sentence().starts_with("f.toml: `system` is missing; add the name of a system"));
    let found = Document::load("wlak", &[]).unwrap_err();
    assert_eq!(found.sentence(), "wlak is neither a file nor a built-in scenario; did you mean `walk`?");
}
