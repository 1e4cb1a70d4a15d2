//! What changes a document: `--set`, and a file on top of its base.

use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use crate::failure::Failure;

/// One `--set key=value`.
#[derive(Debug)]
pub struct Override {
    text: String,
    key: String,
    value: Value,
}

impl Override {
    /// Reads `key=value`; the value is TOML, else a bare string.
    pub fn parse(text: &str) -> Result<Self, Failure> {
        let wrong = |problem: &str| Failure::input(format!("--set {text}: {problem}, as in world.steps=20"));
        let (key, value) = text.split_once('=').ok_or_else(|| wrong("write KEY=VALUE"))?;
        let key = key.trim();
        if key.is_empty() || key.split('.').any(str::is_empty) {
            return Err(wrong("the key is a dotted path"));
        }
        let value = value.trim();
        let value = value.parse().unwrap_or_else(|_| Value::String(value.to_owned()));
        Ok(Self { text: text.to_owned(), key: key.to_owned(), value })
    }

    /// As it was written.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Whether a fault at `key` is due to this override: it set the key, a part of it, or a table around it.
    pub fn concerns(&self, key: &str) -> bool {
        let within = |inner: &str, outer: &str| {
            inner.strip_prefix(outer).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
        };
        within(key, &self.key) || within(&self.key, key)
    }

    /// Replaces the value of the key, making tables on the way.
    ///
    /// # Errors
    /// The key leads through a value that is no table, or to a method that does not exist.
    pub fn apply(&self, table: &mut Table) -> Result<(), Failure> {
        let mut parts: Vec<&str> = self.key.split('.').collect();
        let Some(last) = parts.pop() else {
            return Ok(());
        };
        if let ["method", id, ..] = parts[..]
            && let Some(Value::Table(methods)) = table.get("method")
            && !methods.contains_key(id)
        {
            let known = methods.keys().map(String::as_str).collect::<Vec<_>>().join(", ");
            let sentence =
                format!("--set {}: there is no method `{id}`; the scenario has {known}", self.text);
            return Err(Failure::input(sentence));
        }
        let mut at = table;
        for (depth, part) in parts.iter().enumerate() {
            let next = at.entry(*part).or_insert_with(|| Value::Table(Table::new()));
            let kind = next.type_str();
            at = next.as_table_mut().ok_or_else(|| {
                let whole = parts[..=depth].join(".");
                let set = &self.text;
                Failure::input(format!(
                    "--set {set}: `{whole}` is no table but of type {kind}; set `{whole}` itself"
                ))
            })?;
        }
        at.insert(last.to_owned(), self.value.clone());
        Ok(())
    }
}

/// Lays `over` on `base`. `parsed` is the same document as `over` with the places of its values in `text`, which
/// tell inline tables from the others.
pub fn merge(base: &mut Table, over: &Table, parsed: &DeTable<'_>, text: &str) {
    for (key, value) in over {
        let written = parsed.iter().find(|(name, _)| name.get_ref().as_ref() == key).map(|(_, value)| value);
        if let (Some(Value::Table(below)), Value::Table(above), Some(written)) =
            (base.get_mut(key), value, written)
            && let DeValue::Table(inner) = written.get_ref()
            && !text[written.span()].starts_with('{')
        {
            merge(below, above, inner, text);
            continue;
        }
        base.insert(key.clone(), value.clone());
    }
}
