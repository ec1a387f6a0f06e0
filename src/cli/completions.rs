//! `qirf-vk completions SHELL`.

use super::console::Console;
use crate::job::Error;
use clap_complete::Shell;

const EXAMPLES: &str = r"Examples:
  mkdir -p ~/.local/share/bash-completion/completions
  qirf-vk completions bash > ~/.local/share/bash-completion/completions/qirf-vk
  mkdir -p ~/.zfunc
  qirf-vk completions zsh > ~/.zfunc/_qirf-vk
  mkdir -p ~/.config/fish/completions
  qirf-vk completions fish > ~/.config/fish/completions/qirf-vk.fish
  qirf-vk completions powershell > qirf-vk.ps1

For zsh, ~/.zshrc needs before compinit: fpath+=(~/.zfunc)

For PowerShell, $PROFILE needs: . C:\path\to\qirf-vk.ps1";

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// The shell
    shell: Shell,
}

impl Arguments {
    pub fn run(&self, console: &Console) -> Result<(), Error> {
        let mut text = Vec::new();
        clap_complete::generate(self.shell, &mut super::command(), "qirf-vk", &mut text);
        let mut text = String::from_utf8_lossy(&text).into_owned();
        if self.shell == Shell::Bash {
            // For the hyphen of the program's name, clap_complete 4.6 writes __ where the script sets `cmd`, but __subcmd__ where
            // it compares it: only the first word would be completed. The replacement can go when both places have the same.
            text = text.replace("qirf__subcmd__vk", "qirf__vk");
        }
        console.print(text.trim_end())
    }
}
