# Four binders. First: nomad var put nomad/jobs/rtc-workers key=@w1.key
job "rtc-workers" {
  type = "service"

  group "binder" {
    count = 4 # at most 32 workers a key

    restart {
      attempts = 10
      interval = "5m"
      delay    = "5s"
      mode     = "delay"
    }

    task "worker" {
      driver       = "exec"
      user         = "nobody"
      kill_signal  = "SIGTERM"
      kill_timeout = "30s" # longer than the longest job (15 s)

      config {
        command = "/opt/telerobot-rtc/.venv/bin/python"
        args    = ["-m", "rtc", "workers", "--kind", "binder", "--with", "${NOMAD_SECRETS_DIR}/w.key"]
      }

      template {
        data        = "{{ with nomadVar \"nomad/jobs/rtc-workers\" }}{{ .key }}{{ end }}"
        destination = "secrets/w.key"
        perms       = "0400"
        uid         = 65534 # nobody
      }

      resources {
        cores  = 1
        memory = 1024
      }
    }
  }
}
